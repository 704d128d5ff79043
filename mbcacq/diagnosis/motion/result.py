"""The diagnosis of motion as one object, and as the JSON (mbcacq-diagnosis/3) that other programs read; version 1 is read too."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, computed_field

from mbcacq.diagnosis.result import FORMAT, READABLE, Advice, Alternative, EvidenceSummary, NotSeparable
from mbcacq.effects.effect import ParameterEstimate, parameter_in_words
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.trend import trend
from mbcacq.errors import ConfigError
from mbcacq.model.channel_series import MotionSeries
from mbcacq.model.json_text import EveryKey, InJson, Number, damage, fields_as_json, from_fields

Json = dict[str, Any]


@dataclass(frozen=True)
class MotionMismatch:
    """A dependence of one kind of mismatch. at: joint or channel; share: of that kind's held-out excess over the noise."""

    at: str
    channel: str
    depends_on: str
    share: Number
    p_value: Number


@dataclass(frozen=True)
class MotionStep:
    """One form of an effect, in the order of selection. adds: names of its parameters; held_out_before_rms, held_out_after_rms: by joint,
    in the unit of the channel (deg, N m)."""

    adds: tuple[str, ...]
    held_out_before_rms: Mapping[str, Number]
    held_out_after_rms: Mapping[str, Number]


@dataclass(frozen=True)
class MotionEffect:
    """A parametric effect that was found.

    parameters: by name, with the unit as its suffix. held_out_gain: share of the
    excess of its kind of mismatch over the noise that it removes on held-out data; held_out_gain_here: of that of its own joints. Together
    the effects of a joint remove what the table of channels says. notes: what its parameters leave open. trend: as of ``EffectFound``.
    """

    name: str
    where: tuple[str, ...]
    depends_on: str
    channel: str
    parameters: Mapping[str, ParameterEstimate]
    p_value: Number
    held_out_gain: Number
    held_out_gain_here: Number
    alternatives: tuple[Alternative, ...]
    steps: tuple[MotionStep, ...]
    notes: tuple[str, ...] = ()
    trend: str = field(init=False, default="")

    def __post_init__(self) -> None:
        sizes = {name: estimate.components for name, estimate in self.parameters.items()}
        object.__setattr__(self, "trend", trend(sizes, self.held_out_gain_here))


@dataclass(frozen=True)
class ResponseShape:
    """Mean ``y`` over bins ``x`` of a covariate, in SI units."""

    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True)
class UnmodelledMotionEffect:
    """Structure in a residual that no effect of the catalogue explains: its ``shape`` over the covariate ``depends_on``. It is
    named 'unknown'."""

    where: tuple[str, ...]
    channel: str
    depends_on: str
    p_value: Number
    held_out_gain: Number
    shape: ResponseShape
    name: str = field(init=False, default=UNKNOWN)
    parameters: Mapping[str, ParameterEstimate] = field(init=False, default_factory=dict)
    alternatives: tuple[Alternative, ...] = field(init=False, default=())

    trend = ""


@dataclass(frozen=True)
class ErrorBeforeAfter:
    """Root mean square, in the unit of the channel, and chi2 per degree of freedom: of the base alone, and with the effects."""

    before_rms: Number
    after_rms: Number
    before_chi2_dof: Number
    after_chi2_dof: Number


@dataclass(frozen=True)
class ChannelFit:
    """How well one joint of one channel is explained. unit: 'deg' or 'N m', also of noise_floor (one standard deviation).

    refused_rms: held-out rms of a model that made this joint worse and is refused there (then ``held_out`` is the same before and after);
    None where the model is kept.
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
        return cls(float(np.mean([e.before_chi2_dof for e in errors])), float(np.mean([e.after_chi2_dof for e in errors])))


@dataclass(frozen=True)
class HeldOutChi2(MeanChi2):
    split: str = ""


@dataclass(frozen=True)
class FitOfMotion:
    """The fits of all channels, and their means."""

    train: MeanChi2
    held_out: HeldOutChi2
    channels: tuple[ChannelFit, ...]


def _effect(content: Any) -> MotionEffect | UnmodelledMotionEffect:
    return from_fields(UnmodelledMotionEffect if content["name"] == UNKNOWN else MotionEffect, content)


EitherEffect = Annotated[MotionEffect | UnmodelledMotionEffect, InJson(Any, _effect, fields_as_json)]


@dataclass(frozen=True, repr=False, kw_only=True)
class MotionDiagnosis(EveryKey):
    """What was found in recordings of motion.

    verdict: 'none', 'explained', 'partly_explained', 'unexplained' or 'cannot_tell'. mismatch: by falling share. effects: by falling
    held-out gain. channels: one fit a channel and joint. split: how data were held out, by 'trajectory' or 'time block'.
    not_separable: effects asked for that are not told apart, and advice: what to record for that. inertial: of the links and of a tool
    that was found. suspicions: what in the description of the data looks wrong, in words. evidence: of the sets of effects that were
    compared, one for each kind of mismatch; empty in older files. checks: what the effects leave of other recordings, where that was asked.
    plot_data: a ``MotionSeries`` from which pictures are drawn; it is no part of the JSON.
    """

    left_out = ("checks",)
    later = ("not_separable", "advice", "inertial", "suspicions", "evidence", "plot_data")

    verdict: str
    mismatch: tuple[MotionMismatch, ...]
    effects: tuple[EitherEffect, ...]
    channels: Annotated[tuple[ChannelFit, ...], Field(exclude=True)]
    split: Annotated[str, Field(exclude=True)]
    not_separable: tuple[NotSeparable, ...] = ()
    advice: tuple[Advice, ...] = ()
    inertial: tuple[BodyInertia, ...] = ()
    suspicions: tuple[str, ...] = ()
    evidence: tuple[ChannelEvidence, ...] = ()
    checks: Annotated[tuple[MotionCheck, ...], Field(alias="motion_checks")] = ()
    plot_data: Annotated[object | None, Field(exclude=True)] = field(default=None, compare=False)

    @computed_field
    @property
    def fit(self) -> FitOfMotion:
        """The fits of all channels, as the JSON has them."""
        train, held = (MeanChi2.of([getattr(c, which) for c in self.channels]) for which in ("train", "held_out"))
        return FitOfMotion(train, HeldOutChi2(held.before_chi2_dof, held.after_chi2_dof, self.split), self.channels)

    @property
    def series(self) -> MotionSeries:
        """The channels over time. Raises ConfigError for a diagnosis that was read from JSON."""
        if not isinstance(self.plot_data, MotionSeries):
            raise ConfigError("a diagnosis of motion that was read from JSON has no channels to draw; diagnose the recording again")
        return self.plot_data

    @property
    def named_effects(self) -> tuple[MotionEffect, ...]:
        """The parametric effects."""
        return tuple(e for e in self.effects if isinstance(e, MotionEffect))

    def to_json(self) -> Json:
        """The contract mbcacq-diagnosis/3; what is not finite is null."""
        return {"format": FORMAT} | fields_as_json(self)

    @classmethod
    def from_json(cls, content: Json) -> MotionDiagnosis:
        """From what ``to_json`` gave. Raises ConfigError for another format, a diagnosis of poses, and a damaged one."""
        fit = content.get("fit", {})
        if content.get("format") not in READABLE or "channels" not in fit:
            raise ConfigError(f"this is not the diagnosis of a motion: it needs format {FORMAT} and fit.channels")
        try:
            return from_fields(cls, {**content, "channels": fit["channels"], "split": fit["held_out"]["split"]})
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ConfigError(f"the diagnosis is damaged ({damage(error)}); write it again with mbcacq diagnose --out FILE") from error

    def __repr__(self) -> str:
        lines = [f"MotionDiagnosis: {self.verdict}, {len(self.effects)} effects"]
        for effect in self.effects:
            lines.append(f"  {effect.name} at {', '.join(effect.where)} ({effect.channel}): held-out gain {effect.held_out_gain:.1%}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """A table for a notebook."""
        heads = "".join(f"<th>{head}</th>" for head in ("effect", "where", "channel", "held-out gain", "parameters"))
        rows = "".join(
            f"<tr><td>{html.escape(e.name)}</td><td>{html.escape(', '.join(e.where))}</td><td>{html.escape(e.channel)}</td>"
            f"<td>{e.held_out_gain:.1%}</td><td>{html.escape(_parameters(e))}</td></tr>"
            for e in self.effects
        )
        return f"<p>Verdict: <b>{html.escape(self.verdict)}</b></p><table><tr>{heads}</tr>{rows}</table>"


def _parameters(effect: MotionEffect | UnmodelledMotionEffect) -> str:
    """In words with units, ± U (k = 2); of a trend no figure."""
    if effect.trend:
        return f"a trend: {effect.trend}"
    return "; ".join(parameter_in_words(name, estimate) for name, estimate in effect.parameters.items())
