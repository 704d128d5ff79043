"""The diagnosis as typed objects, and as the JSON object (``mbcacq-diagnosis/2``) that other programs read; version 1 is read too.

Every class here is plain data: it pickles, and its fields are the keys of the JSON object, in their order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from html import escape
from typing import Any

import numpy as np

from mbcacq.diagnosis.geometry_alone import GeometryAlone
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import damage

FORMAT_1, FORMAT = "mbcacq-diagnosis/1", "mbcacq-diagnosis/2"
READABLE = (FORMAT_1, FORMAT)


@dataclass(frozen=True)
class MismatchEntry:
    """A location and covariate at which recording and simulation differ. share: of the excess of chi2 over the noise, 0 to 1.

    equivalent: other locations that move these centres alike, so that these data cannot tell which it is.
    """

    at: str
    depends_on: str
    share: float
    p_value: float
    equivalent: tuple[str, ...] = ()


@dataclass(frozen=True)
class Alternative:
    """An effect that could stand in place of a found one. held_out_gain: share of the excess that it would remove, 0 to 1. odds:
    its posterior probability relative to the found effect's; None where that was not computed.
    """

    name: str
    where: tuple[str, ...]
    held_out_gain: float
    odds: float | None = None


@dataclass(frozen=True)
class EffectFound:
    """One effect that the diagnosis reports. name: of the catalogue, or ``unknown`` for an unmodelled effect.

    parameters: by name, with the unit as its suffix. p_value: as in version 1 of the format: p_local of a parametric effect, exp(-log Bayes
    factor) of an unmodelled one. held_out_gain: share of the held-out excess over the noise floor that the effect removes, 0 to 1.
    p_local: probability that noise alone gains as much by these very coefficients; None for an unmodelled effect. p_corrected: by anything
    that was tried (all candidates and values of their hyper-parameters, or all locations). log_bayes_factor: natural logarithm, of an
    unmodelled effect against none. equivalent: other locations that act alike on these data.
    """

    name: str
    where: tuple[str, ...]
    parameters: Mapping[str, ParameterEstimate]
    p_value: float
    held_out_gain: float
    alternatives: tuple[Alternative, ...] = ()
    depends_on: str = ""
    p_local: float | None = None
    p_corrected: float | None = None
    log_bayes_factor: float | None = None
    equivalent: tuple[str, ...] = ()


@dataclass(frozen=True)
class FitFigures:
    """How well the geometry alone (before) and the model with its effects (after) agree with centres: rms of 3D distances in mm, and
    chi2 per degree of freedom under the full noise model.
    """

    before_rms_mm: float
    after_rms_mm: float
    before_chi2_dof: float
    after_chi2_dof: float


@dataclass(frozen=True)
class HeldOutFigures(FitFigures):
    """The same figures on held-out data: in no choice and no fit. split: ``station`` or ``block``, what was left out at a time."""

    split: str


@dataclass(frozen=True)
class FitSummary:
    """repeatability_floor_mm: 3D rms expected at one centre from the estimated noise alone."""

    train: FitFigures
    held_out: HeldOutFigures
    repeatability_floor_mm: float


TOGETHER = " and "  # between effects that stand together on one side of a pair


@dataclass(frozen=True)
class NotSeparable:
    """Two effects, as ``name:where``, that these data cannot tell apart, and the correlation of what they explain. Several that stand
    together are joined by ' and '. odds: posterior probability of the second relative to the first; None where that was not computed.
    """

    effects: tuple[str, ...]
    correlation: float
    odds: float | None = None


@dataclass(frozen=True)
class BetweenRecordings:
    """One parameter of an effect over several recordings of one arm.

    values, stds: fitted to each recording by itself. common +- common_std: what they share, its uncertainty with the variance between
    recordings; between_std: standard deviation from day to day beyond each value's own; p_value: of values that differ as much although
    nothing changed.
    """

    name: str
    where: tuple[str, ...]
    parameter: str
    values: tuple[float, ...]
    stds: tuple[float, ...]
    common: float
    common_std: float
    between_std: float
    p_value: float


@dataclass(frozen=True)
class Advice:
    """What to measure next and why; poses_deg: joint angles, one tuple a pose."""

    reason: str
    poses_deg: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class ExclusionLimit:
    """The largest size of an effect at a location that the recording does not exclude, with 95 % confidence.

    parameter: its name, with the unit as suffix; value: None where the free geometry absorbs the effect. workspace_mm: largest error that
    it would make in the workspace. length_mm: error of a length between two postures that 95 % of lengths do not exceed. Both are None for
    what depends on time or on single balls.
    """

    name: str
    where: tuple[str, ...]
    parameter: str
    value: float | None
    workspace_mm: float | None
    length_mm: float | None


@dataclass(frozen=True)
class Proposal:
    """A short formula for an unmodelled effect that was located.

    where: its location; formula: what is displaced, by which functions, with the fitted coefficients. terms: of what it is a function,
    whatever the phase, e.g. ``q4*q6``. log_bayes_factor: natural logarithm, against no effect there; odds: posterior probability
    relative to the most probable formula. held_out_before_chi2_dof, held_out_chi2_dof, held_out_rms_mm: on data left out, without the
    formula and with it; smooth_chi2_dof: with the smooth model in its place. found_in, parts: of how many repetitions of the search
    without a part of the data it was among the reported. term: the formula as a term, from which a draft of an effect is written.
    """

    where: tuple[str, ...]
    formula: str
    terms: tuple[str, ...]
    log_bayes_factor: float
    odds: float
    held_out_before_chi2_dof: float
    held_out_chi2_dof: float
    held_out_rms_mm: float
    smooth_chi2_dof: float
    found_in: int
    parts: int
    term: EffectTerm


@dataclass(frozen=True)
class Diagnosis:
    """The result of ``diagnose``.

    verdict: ``none``, ``explained``, ``partly_explained``, ``unexplained`` or ``cannot_tell``. mismatch: largest share first.
    geometry_alone: the cell of each recording before any effect, as a calibration has it; empty in older files. dropped: effects that were
    not considered, with what the recording lacks for them. notes: further sentences for people. exclusion_limits: of all effects that
    were not found, those with the largest error first. between_recordings: of several recordings of one arm. proposals: formulas for
    unmodelled effects, where they were asked for, the most probable of each location first. model: the effects as terms that a
    calibration takes; None where there is none. plot_data: an ``output.plot_data.PlotData`` from which pictures are drawn; it is no part
    of the JSON object, so None after ``from_json``.
    """

    verdict: str
    mismatch: tuple[MismatchEntry, ...]
    effects: tuple[EffectFound, ...]
    fit: FitSummary
    geometry_alone: tuple[GeometryAlone, ...] = ()
    not_separable: tuple[NotSeparable, ...] = ()
    advice: tuple[Advice, ...] = ()
    dropped: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    exclusion_limits: tuple[ExclusionLimit, ...] = ()
    between_recordings: tuple[BetweenRecordings, ...] = ()
    proposals: tuple[Proposal, ...] = ()
    model: EffectModel | None = field(default=None, compare=False)
    plot_data: object | None = field(default=None, compare=False)

    def to_json(self) -> dict[str, Any]:
        """The JSON object as Python lists, dictionaries and numbers; a number that is not finite becomes None."""
        apart = ("plot_data", "model", "proposals")
        content = {"format": FORMAT} | {f.name: plain(getattr(self, f.name)) for f in fields(self) if f.name not in apart}
        content["geometry_alone"] = [plain(one.to_dict()) for one in self.geometry_alone]
        proposals = [plain({**vars(p), "term": p.term.to_dict()}) for p in self.proposals]
        return content | {"proposals": proposals, "model": plain(self.model.to_dict()) if self.model else None}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Diagnosis:
        """The diagnosis that ``to_json`` wrote; a None becomes not-a-number, keys that the format does not have are left out.

        Raises ConfigError where the object has another format or lacks a key.
        """
        kind = content.get("format")
        if kind not in READABLE:
            said = f"its format is '{kind}'" if kind else "it does not say its format"
            raise ConfigError(f"this is no diagnosis: {said}, which should be '{FORMAT}'; give what mbcacq diagnose --out writes")
        try:
            return _read_diagnosis(content)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ConfigError(f"the diagnosis is damaged ({damage(error)}); write it again with mbcacq diagnose --out FILE") from error

    def __repr__(self) -> str:
        found = "; ".join(f"{e.name} at {', '.join(e.where)}" for e in self.effects) or "no effect"
        held = self.fit.held_out
        return f"<Diagnosis {self.verdict}: {found}; held-out rms {held.before_rms_mm:.4f} -> {held.after_rms_mm:.4f} mm>"

    def _repr_html_(self) -> str:
        """A table of the effects for a notebook."""
        held = self.fit.held_out
        rows = [
            (
                e.name,
                ", ".join(e.where),
                "<br>".join(f"{escape(k)} = {escape(str(v))}" for k, v in list(e.parameters.items())[:8]),
                f"{e.held_out_gain:.0%}",
            )
            for e in self.effects
        ]
        body = "".join(f"<tr><td>{escape(n)}</td><td>{escape(w)}</td><td>{p}</td><td>{g}</td></tr>" for n, w, p, g in rows)
        table = f"<table><tr><th>effect</th><th>where</th><th>parameters</th><th>removes</th></tr>{body}</table>" if rows else ""
        return (
            f"<p><b>{escape(self.verdict)}</b>; held out: {held.before_rms_mm:.4f} mm before, {held.after_rms_mm:.4f} mm after; "
            f"chi2/dof {held.before_chi2_dof:.2f} before, {held.after_chi2_dof:.2f} after</p>{table}"
        )


def plain(value: Any) -> Any:
    """Only what JSON has: dataclasses become dictionaries, numpy numbers become numbers, what is not finite becomes None."""
    if is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in fields(value)}
    elif isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _read_diagnosis(content: Mapping[str, Any]) -> Diagnosis:
    fit = content["fit"]
    return Diagnosis(
        verdict=content["verdict"],
        mismatch=tuple(
            MismatchEntry(m["at"], m["depends_on"], _number(m["share"]), _number(m["p_value"]), tuple(m.get("equivalent", ())))
            for m in content["mismatch"]
        ),
        effects=tuple(_read_effect(e) for e in content["effects"]),
        fit=FitSummary(
            FitFigures(*_figures(fit["train"])),
            HeldOutFigures(*_figures(fit["held_out"]), fit["held_out"]["split"]),
            _number(fit["repeatability_floor_mm"]),
        ),
        geometry_alone=tuple(GeometryAlone.from_dict(one) for one in content.get("geometry_alone", ())),
        not_separable=tuple(NotSeparable(tuple(p["effects"]), _number(p["correlation"]), p.get("odds")) for p in content["not_separable"]),
        advice=tuple(Advice(a["reason"], tuple(tuple(_number(v) for v in q) for q in a["poses_deg"])) for a in content["advice"]),
        dropped=dict(content.get("dropped", {})),
        notes=tuple(content.get("notes", ())),
        exclusion_limits=tuple(_read_limit(e) for e in content.get("exclusion_limits", ())),
        between_recordings=tuple(
            BetweenRecordings(**{**b, "where": tuple(b["where"]), "values": tuple(b["values"]), "stds": tuple(b["stds"])})
            for b in content.get("between_recordings", ())
        ),
        proposals=tuple(_read_proposal(p) for p in content.get("proposals", ())),
        model=EffectModel.from_dict(content["model"]) if content.get("model") else None,
    )


def _read_limit(e: Mapping[str, Any]) -> ExclusionLimit:
    return ExclusionLimit(e["name"], tuple(e["where"]), e["parameter"], e["value"], e["workspace_mm"], e["length_mm"])


def _read_proposal(p: Mapping[str, Any]) -> Proposal:
    numbers = {f.name: _number(p[f.name]) for f in fields(Proposal) if f.type == "float"}
    whole = {key: tuple(p[key]) for key in ("where", "terms")}
    return Proposal(**{**p, **numbers, **whole, "term": EffectTerm.from_dict(p["term"])})


def _read_effect(e: Mapping[str, Any]) -> EffectFound:
    return EffectFound(
        name=e["name"],
        where=tuple(e["where"]),
        parameters={k: ParameterEstimate(_numbers(p["value"]), _numbers(p["std"])) for k, p in e["parameters"].items()},
        p_value=_number(e["p_value"]),
        held_out_gain=_number(e["held_out_gain"]),
        alternatives=tuple(
            Alternative(a["name"], tuple(a["where"]), _number(a["held_out_gain"]), a.get("odds")) for a in e["alternatives"]
        ),
        depends_on=e.get("depends_on", ""),
        p_local=e.get("p_local"),
        p_corrected=e.get("p_corrected"),
        log_bayes_factor=e.get("log_bayes_factor"),
        equivalent=tuple(e.get("equivalent", ())),
    )


def _figures(part: Mapping[str, Any]) -> tuple[float, float, float, float]:
    return (
        _number(part["before_rms_mm"]),
        _number(part["after_rms_mm"]),
        _number(part["before_chi2_dof"]),
        _number(part["after_chi2_dof"]),
    )


def _numbers(value: float | Sequence[float] | None) -> float | tuple[float, ...]:
    return tuple(_number(v) for v in value) if isinstance(value, Sequence) else _number(value)


def _number(value: float | None) -> float:
    return np.nan if value is None else value
