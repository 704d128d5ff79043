"""The diagnosis of motion as one object, and as the JSON (mbcacq-diagnosis/3) that other programs read; version 1 is read too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field

from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.findings import FORMAT, OUT_OF_TIME, EvidenceSummary, Findings
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.errors import ConfigError
from mbcacq.model.channel_series import MotionSeries
from mbcacq.model.json_text import EveryKey, Number
from mbcacq.quantities import capitalised


@dataclass(frozen=True)
class ErrorBeforeAfter:
    """Root mean square, in the unit of the channel, and chi2 per degree of freedom: of the base alone, and with the effects."""

    before_rms: Number
    after_rms: Number
    before_chi2_dof: Number
    after_chi2_dof: Number


@dataclass(frozen=True)
class ChannelFit:
    """How well one joint of one channel is explained.

    Attributes
    ----------
    unit : str
        'deg' or 'N m', also of noise_floor (one standard deviation).
    refused_rms : float or None
        Held-out rms of a model that made this joint worse and is refused there (then ``held_out`` is the same before and after); None where
        the model is kept.
    """

    channel: str
    at: str
    unit: str
    noise_floor: Number
    train: ErrorBeforeAfter
    held_out: ErrorBeforeAfter
    refused_rms: float | None = None


@dataclass(frozen=True)
class CheckedChannel:
    """What the effects leave of one joint of one channel in another recording. unit: 'deg' or 'N m'."""

    channel: str
    at: str
    unit: str
    error: ErrorBeforeAfter


@dataclass(frozen=True)
class MotionCheck:
    """What was learnt, tried on a recording by which nothing was selected, fitted or refused. recording: its name, or ''."""

    recording: str
    channels: tuple[CheckedChannel, ...]


@dataclass(frozen=True)
class BodyInertia:
    """Inertial parameters of a link in its own frame, as found: of a rigid body that can exist. tensor: Ixx, Ixy, Ixz, Iyy, Iyz, Izz about
    the origin of the frame."""

    body: str
    mass_kg: Number
    first_moment_kg_mm: tuple[float, ...]
    tensor_kg_m2: tuple[float, ...]


@dataclass(frozen=True)
class ChannelEvidence:
    """What decides whether one kind of mismatch (``channel``) shows an effect, and which. poses: of its evidence, is zero."""

    channel: str
    evidence: EvidenceSummary


@dataclass(frozen=True)
class MeanChi2:
    """Chi2 per degree of freedom of the base alone and with the effects, mean over all channels."""

    before_chi2_dof: Number
    after_chi2_dof: Number

    @classmethod
    def of(cls, errors: Sequence[ErrorBeforeAfter]) -> Self:
        each = [e.before_chi2_dof for e in errors], [e.after_chi2_dof for e in errors]
        return cls(*(float(np.mean(chi2)) if chi2 else np.nan for chi2 in each))


@dataclass(frozen=True)
class HeldOutChi2(MeanChi2):
    split: str = ""


@dataclass(frozen=True)
class FitOfMotion:
    """The fits of all channels, and their means. channels: one fit a channel and joint."""

    train: MeanChi2
    held_out: HeldOutChi2
    channels: tuple[ChannelFit, ...]

    @classmethod
    def of(cls, channels: Sequence[ChannelFit], split: str) -> Self:
        """split: how data were held out, by 'trajectory' or 'time block'."""
        train, held = (MeanChi2.of([getattr(c, which) for c in channels]) for which in ("train", "held_out"))
        return cls(train, HeldOutChi2(held.before_chi2_dof, held.after_chi2_dof, split), tuple(channels))


@dataclass(frozen=True, repr=False, kw_only=True)
class MotionDiagnosis(Findings, EveryKey):
    """What was found in recordings of motion.

    mismatch: by falling share. effects: by falling held-out gain. not_separable: effects asked for that are not told apart, and advice:
    what to record for that. inertial: of the links and of a tool that was found. suspicions: what in the description of the data looks
    wrong, in words. evidence: of the sets of effects that were compared, one for each kind of mismatch; empty in older files. checks: what
    the effects leave of other recordings, where that was asked. plot_data: a ``MotionSeries``.
    """

    data = "motions"
    left_out = ("checks",)
    later = ("not_separable", "advice", "inertial", "suspicions", "evidence")

    fit: FitOfMotion
    inertial: tuple[BodyInertia, ...] = ()
    suspicions: tuple[str, ...] = ()
    evidence: tuple[ChannelEvidence, ...] = ()
    checks: Annotated[tuple[MotionCheck, ...], Field(alias="motion_checks")] = ()

    @property
    def series(self) -> MotionSeries:
        """The channels over time. Raises ConfigError for a diagnosis that was read from JSON."""
        if not isinstance(self.plot_data, MotionSeries):
            raise ConfigError("a diagnosis of motion that was read from JSON has no channels to draw; diagnose the recording again")
        return self.plot_data

    @property
    def named_effects(self) -> tuple[EffectFound, ...]:
        """The parametric effects."""
        return tuple(e for e in self.effects if e.name != UNKNOWN)

    @property
    def out_of_time(self) -> bool:
        return OUT_OF_TIME in self.suspicions

    @property
    def remarks(self) -> list[str]:
        """The suspicions as sentences without a full stop. The sentence that time ran out is added to them; it is no suspicion."""
        return [capitalised(s) if s == OUT_OF_TIME else f"The description of the data looks wrong: {s}" for s in self.suspicions]

    @property
    def held_out(self) -> str:
        held = self.fit.held_out
        return f"χ²/dof {held.before_chi2_dof:.2f} before, {held.after_chi2_dof:.2f} after"

    @classmethod
    def from_json(cls, content: Any) -> Self:
        """The diagnosis that ``to_json`` wrote. Raises ConfigError for another format, a diagnosis of poses, and a damaged one."""
        if not is_of_motion(content):
            raise ConfigError(f"this is not the diagnosis of a motion: it needs format {FORMAT} and fit.channels")
        return super().from_json(content)


def is_of_motion(content: Any) -> bool:
    """Whether the JSON content of a diagnosis is of a motion alone, and not of poses."""
    fit = content.get("fit") if isinstance(content, Mapping) else None
    return isinstance(fit, Mapping) and "channels" in fit
