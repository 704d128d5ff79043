"""The diagnosis of motion as one object, and as the JSON (mbcacq-diagnosis/3) that other programs read; version 1 is read too."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbcacq.diagnosis.result import FORMAT, READABLE, Advice, Alternative, ComparedEffect, ComparedSet, EvidenceSummary, NotSeparable, plain
from mbcacq.effects.effect import ParameterEstimate, parameter_in_words
from mbcacq.errors import ConfigError

Json = dict[str, Any]


@dataclass(frozen=True)
class MotionMismatch:
    """A dependence of one kind of mismatch. at: joint or channel; share: of that kind's held-out excess over the noise."""

    at: str
    channel: str
    depends_on: str
    share: float
    p_value: float

    @classmethod
    def from_json(cls, content: Json) -> MotionMismatch:
        share, p = _number(content["share"]), _number(content["p_value"])
        return cls(content["at"], content["channel"], content["depends_on"], share, p)


@dataclass(frozen=True)
class MotionStep:
    """One form of an effect, in the order of selection. adds: names of its parameters; held_out_before_rms, held_out_after_rms: by joint,
    in the unit of the channel (deg, N m)."""

    adds: tuple[str, ...]
    held_out_before_rms: Mapping[str, float]
    held_out_after_rms: Mapping[str, float]

    @classmethod
    def from_json(cls, content: Json) -> MotionStep:
        return cls(tuple(content["adds"]), content["held_out_before_rms"], content["held_out_after_rms"])


@dataclass(frozen=True)
class MotionEffect:
    """A parametric effect that was found.

    parameters: name (its unit is the ending) -> ``{"value": .., "std": ..}``, numbers or lists of numbers. held_out_gain: share of the
    excess of its kind of mismatch over the noise that it removes on held-out data; held_out_gain_here: of that of its own joints. Together
    the effects of a joint remove what the table of channels says. notes: what its parameters leave open.
    """

    name: str
    where: tuple[str, ...]
    depends_on: str
    channel: str
    parameters: Mapping[str, Mapping[str, Any]]
    p_value: float
    held_out_gain: float
    held_out_gain_here: float
    alternatives: tuple[Alternative, ...]
    steps: tuple[MotionStep, ...]
    notes: tuple[str, ...] = ()

    def to_json(self) -> Json:
        return asdict(self)

    @classmethod
    def from_json(cls, content: Json) -> MotionEffect:
        alternatives = tuple(_alternative(a) for a in content["alternatives"])
        steps = tuple(MotionStep.from_json(s) for s in content["steps"])
        gains = _number(content["held_out_gain"]), _number(content["held_out_gain_here"])
        where, p = tuple(content["where"]), _number(content["p_value"])
        return cls(
            content["name"],
            where,
            content["depends_on"],
            content["channel"],
            content["parameters"],
            p,
            *gains,
            alternatives,
            steps,
            tuple(content.get("notes", ())),
        )


@dataclass(frozen=True)
class UnmodelledMotionEffect:
    """Structure in a residual that no effect of the catalogue explains: its mean ``y`` over bins ``x`` of the covariate ``depends_on``,
    in SI units. It is named 'unknown'."""

    where: tuple[str, ...]
    channel: str
    depends_on: str
    p_value: float
    held_out_gain: float
    x: tuple[float, ...]
    y: tuple[float, ...]

    name = "unknown"

    @property
    def parameters(self) -> Mapping[str, Mapping[str, Any]]:
        return {}

    def to_json(self) -> Json:
        return {
            "name": self.name,
            "where": self.where,
            "channel": self.channel,
            "depends_on": self.depends_on,
            "parameters": {},
            "p_value": self.p_value,
            "held_out_gain": self.held_out_gain,
            "shape": {"x": self.x, "y": self.y},
            "alternatives": [],
        }

    @classmethod
    def from_json(cls, content: Json) -> UnmodelledMotionEffect:
        shape, gain = content["shape"], _number(content["held_out_gain"])
        x, y = tuple(shape["x"]), tuple(shape["y"])
        return cls(tuple(content["where"]), content["channel"], content["depends_on"], _number(content["p_value"]), gain, x, y)


@dataclass(frozen=True)
class ErrorBeforeAfter:
    """Root mean square, in the unit of the channel, and chi2 per degree of freedom: of the base alone, and with the effects."""

    before_rms: float
    after_rms: float
    before_chi2_dof: float
    after_chi2_dof: float


@dataclass(frozen=True)
class ChannelFit:
    """How well one joint of one channel is explained. unit: 'deg' or 'N m', also of noise_floor (one standard deviation).

    refused_rms: held-out rms of a model that made this joint worse and is refused there (then ``held_out`` is the same before and after);
    None where the model is kept.
    """

    channel: str
    at: str
    unit: str
    noise_floor: float
    train: ErrorBeforeAfter
    held_out: ErrorBeforeAfter
    refused_rms: float | None = None

    @classmethod
    def from_json(cls, content: Json) -> ChannelFit:
        train, held_out = (ErrorBeforeAfter(**{k: _number(v) for k, v in content[part].items()}) for part in ("train", "held_out"))
        floor, refused = _number(content["noise_floor"]), content.get("refused_rms")
        return cls(content["channel"], content["at"], content["unit"], floor, train, held_out, refused)


@dataclass(frozen=True)
class CheckedChannel:
    """What the effects leave of one joint of one channel in another recording. unit: 'deg' or 'N m'."""

    channel: str
    at: str
    unit: str
    error: ErrorBeforeAfter

    @classmethod
    def from_json(cls, content: Json) -> CheckedChannel:
        error = ErrorBeforeAfter(**{k: _number(v) for k, v in content["error"].items()})
        return cls(content["channel"], content["at"], content["unit"], error)


@dataclass(frozen=True)
class MotionCheck:
    """What was learnt, tried on a recording by which nothing was selected, fitted or refused. recording: its name, or ''."""

    recording: str
    channels: tuple[CheckedChannel, ...]

    @classmethod
    def from_json(cls, content: Json) -> MotionCheck:
        return cls(content["recording"], tuple(map(CheckedChannel.from_json, content["channels"])))


@dataclass(frozen=True)
class BodyInertia:
    """Inertial parameters of a link in its own frame, as found: of a rigid body that can exist. tensor: Ixx, Ixy, Ixz, Iyy, Iyz, Izz about
    the origin of the frame."""

    body: str
    mass_kg: float
    first_moment_kg_mm: tuple[float, ...]
    tensor_kg_m2: tuple[float, ...]

    @classmethod
    def from_json(cls, content: Json) -> BodyInertia:
        return cls(content["body"], content["mass_kg"], tuple(content["first_moment_kg_mm"]), tuple(content["tensor_kg_m2"]))


@dataclass(frozen=True)
class ChannelEvidence:
    """What decides whether one kind of mismatch (``channel``) shows an effect, and which. poses: of its evidence, is zero."""

    channel: str
    evidence: EvidenceSummary


@dataclass(frozen=True, repr=False)
class MotionDiagnosis:
    """What was found in recordings of motion.

    verdict: 'none', 'explained', 'partly_explained', 'unexplained' or 'cannot_tell'. mismatch: by falling share. effects: by falling
    held-out gain. channels: one fit a channel and joint. split: how data were held out, by 'trajectory' or 'time block'.
    not_separable: effects asked for that are not told apart, and advice: what to record for that. inertial: of the links and of a tool
    that was found. suspicions: what in the description of the data looks wrong, in words. evidence: of the sets of effects that were
    compared, one for each kind of mismatch; empty in older files. checks: what the effects leave of other recordings, where that was asked.
    """

    verdict: str
    mismatch: tuple[MotionMismatch, ...]
    effects: tuple[MotionEffect | UnmodelledMotionEffect, ...]
    channels: tuple[ChannelFit, ...]
    split: str
    not_separable: tuple[NotSeparable, ...] = ()
    advice: tuple[Advice, ...] = ()
    inertial: tuple[BodyInertia, ...] = ()
    suspicions: tuple[str, ...] = ()
    evidence: tuple[ChannelEvidence, ...] = ()
    checks: tuple[MotionCheck, ...] = ()

    @property
    def named_effects(self) -> tuple[MotionEffect, ...]:
        """The parametric effects."""
        return tuple(e for e in self.effects if isinstance(e, MotionEffect))

    def to_json(self) -> Json:
        """The contract mbcacq-diagnosis/3; what is not finite is null."""
        return plain(
            {
                "format": FORMAT,
                "verdict": self.verdict,
                "mismatch": [asdict(m) for m in self.mismatch],
                "effects": [e.to_json() for e in self.effects],
                "fit": {
                    "train": _mean([c.train for c in self.channels]),
                    "held_out": _mean([c.held_out for c in self.channels]) | {"split": self.split},
                    "channels": [asdict(c) for c in self.channels],
                },
                "not_separable": [asdict(n) for n in self.not_separable],
                "advice": [asdict(a) for a in self.advice],
                "inertial": [asdict(b) for b in self.inertial],
                "suspicions": list(self.suspicions),
                "evidence": [{"channel": e.channel, "evidence": asdict(e.evidence)} for e in self.evidence],
            }
            | ({"motion_checks": [asdict(c) for c in self.checks]} if self.checks else {})
        )

    @classmethod
    def from_json(cls, content: Json) -> MotionDiagnosis:
        """From what ``to_json`` gave. Raises ConfigError for another format or a diagnosis of poses."""
        if content.get("format") not in READABLE or "channels" not in content.get("fit", {}):
            raise ConfigError(f"this is not the diagnosis of a motion: it needs format {FORMAT} and fit.channels")
        mismatch = tuple(MotionMismatch.from_json(m) for m in content["mismatch"])
        kinds = ((e, UnmodelledMotionEffect if e["name"] == UnmodelledMotionEffect.name else MotionEffect) for e in content["effects"])
        channels = tuple(ChannelFit.from_json(c) for c in content["fit"]["channels"])
        effects = tuple(kind.from_json(e) for e, kind in kinds)
        return cls(
            verdict=content["verdict"],
            mismatch=mismatch,
            effects=effects,
            channels=channels,
            split=content["fit"]["held_out"]["split"],
            not_separable=tuple(
                NotSeparable(tuple(n["effects"]), _number(n["correlation"]), n.get("odds")) for n in content["not_separable"]
            ),
            advice=tuple(Advice(a["reason"], tuple(tuple(pose) for pose in a["poses_deg"])) for a in content["advice"]),
            inertial=tuple(BodyInertia.from_json(b) for b in content.get("inertial", ())),
            suspicions=tuple(content.get("suspicions", ())),
            evidence=tuple(ChannelEvidence(e["channel"], _evidence(e["evidence"])) for e in content.get("evidence", ())),
            checks=tuple(map(MotionCheck.from_json, content.get("motion_checks", ()))),
        )

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


def _mean(errors: list[ErrorBeforeAfter]) -> dict[str, float]:
    """Mean chi2 per degree of freedom over all channels."""
    before, after = [e.before_chi2_dof for e in errors], [e.after_chi2_dof for e in errors]
    return {"before_chi2_dof": float(np.mean(before)), "after_chi2_dof": float(np.mean(after))}


def _parameters(effect: MotionEffect | UnmodelledMotionEffect) -> str:
    """In words with units, ± U (k = 2)."""
    return "; ".join(parameter_in_words(name, _estimate(p)) for name, p in effect.parameters.items())


def _estimate(content: Mapping[str, Any]) -> ParameterEstimate:
    def component(value: Any) -> Any:
        return tuple(map(_number, value)) if isinstance(value, list | tuple) else _number(value)

    return ParameterEstimate(component(content["value"]), component(content["std"]))


def _alternative(content: Json) -> Alternative:
    return Alternative(content["name"], tuple(content["where"]), _number(content["held_out_gain"]), content.get("odds"))


def _evidence(content: Json) -> EvidenceSummary:
    sets = tuple(ComparedSet(tuple(_compared(e) for e in one["effects"]), _number(one["log_odds"])) for one in content["sets"])
    return EvidenceSummary(content["poses"], _number(content["log_e_value"]), _number(content["least_log_e_value"]), sets)


def _compared(content: Json) -> ComparedEffect:
    parameters = {name: _estimate(p) for name, p in content["parameters"].items()}
    return ComparedEffect(content["name"], tuple(content["where"]), parameters, content["tried"])


def _number(value: float | None) -> float:
    """A number of the JSON; null stands for one that is not finite."""
    return float("nan") if value is None else value
