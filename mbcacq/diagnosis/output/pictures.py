"""The pictures of a diagnosis as a JSON object, which report and viewer draw: evidence map, residuals before and after, response curves.

A response curve shows how far an effect displaces its location over its covariate, with a band, and what each pose shows by itself.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mbcacq.diagnosis.effect_found import MismatchEntry
from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.nonparametric.design_blocks import DesignBlocks
from mbcacq.diagnosis.nonparametric.evidence_map import EvidenceMap
from mbcacq.diagnosis.nonparametric.joint_model import coefficients_of
from mbcacq.diagnosis.problem import DiagnosisProblem
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_columns import candidate_parts
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Missing
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.errors import ConfigError
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.terms import PER_POSE, Part
from mbcacq.model.cell import axis_of_tag
from mbcacq.model.json_text import plain
from mbcacq.quantities import in_degrees

FORMAT = "mbcacq-diagnosis-pictures/1"
MOST_POINTS = 3000  # centres, and points of a curve, that are drawn
MOST_CURVES = 12
FOLDED = 6.0  # periods a turn from which a harmonic is shown as one period


@dataclass(frozen=True)
class PlotData:
    """The pictures of a diagnosis, and the fitted problem, from which the evidence map is computed when it is first asked for; it pickles.

    centres, causes, curves: as in the JSON object.
    """

    centres: dict[str, Any]
    causes: list[dict[str, Any]]
    curves: list[dict[str, Any]]
    linear: LinearProblem
    noise: Noise
    context: Context

    @cached_property
    def evidence_map(self) -> dict[tuple[str, str], float]:
        """Evidence for a mismatch by location and covariate, before any effect, most significant first."""
        projected = CandidateScoring.of(self.linear, self.noise)
        return EvidenceMap(projected, DesignBlocks(self.context).groups).evaluate(projected).strengths()


def pictures(diagnosis: Diagnosis) -> dict[str, Any]:
    """The JSON object from which pictures are drawn: lengths in mm, in base axes; the centres of a long recording evenly thinned.

    Raises ConfigError for a diagnosis that was read from JSON, which has no plot data.
    """
    data = diagnosis.plot_data
    if not isinstance(data, PlotData):
        raise ConfigError("a diagnosis that was read from JSON has nothing to draw pictures from; diagnose the recording again")
    map_ = [{"at": at, "depends_on": on, "strength": strength} for (at, on), strength in data.evidence_map.items()]
    return plain({"format": FORMAT, "map": map_, "centres": data.centres, "causes": data.causes, "curves": data.curves})


def plot_data(setup: DiagnosisProblem, full: ModelFit, entries: Sequence[MismatchEntry], before: np.ndarray, after: np.ndarray) -> PlotData:
    """The plot data of a fit; before, after: (M, R) mm residuals in the frame of the instrument, of the geometry alone and of the model."""
    context, linear = setup.context, full.geometry_only.linear
    obs = linear.obs
    T = linear.prediction.T_base_scanner if context.scanner_on_flange else linear.prediction.T_base_station
    T = T[obs.pose]
    kept = np.flatnonzero(linear.keep)
    drawn = kept[:: len(kept) // MOST_POINTS + 1]

    def in_base(vectors: np.ndarray) -> np.ndarray:
        return np.einsum("mij,mj->mi", T[:, :3, :3], vectors[:, :3])[drawn]

    centres = {
        "pose": obs.pose_id[obs.pose][drawn],
        "ball": np.array(obs.cell.ball_ids)[obs.ball[drawn]],
        "point_mm": _short(in_base(obs.xyz) + T[drawn, :3, 3]),
        "before_mm": _short(in_base(before)),
        "after_mm": _short(in_base(after)),
        "of": len(kept),
    }
    causes = []
    for name in dict.fromkeys(m.depends_on for m in entries):
        if (values := at_centres(context, name)) is not None:
            label, unit, factor = axis_of(name)
            causes.append({"name": name, "label": label, "unit": unit, "values": _short(factor * values[drawn])})
    curves = response_curves(context, full, after)
    return PlotData(centres, causes[:4], curves, linear, full.geometry_only.noise, context)


def at_centres(context: Context, name: str) -> np.ndarray | None:
    """(M,) values of a covariate; None if the recording lacks it, or where it is always the same."""
    try:
        values = context.value(name)
    except Missing:
        return None
    values = values[context.obs.pose] if len(values) == context.obs.n_poses else values
    return values if np.ptp(values) > 0 else None


def axis_of(depends_on: str) -> tuple[str, str, float]:
    """Label, unit and factor to that unit of a covariate."""
    for pattern, label, unit, factor in (
        (r"q(E?\d+)", "angle of {}", "°", 180 / np.pi),
        (r"s(E?\d+)", "position of {}", "mm", 1.0),
        (r"gravity_torque_(E?\d+)", "gravity torque about {}", "N·m", 1.0),
        (r"direction_(E?\d+)", "direction of {}'s last motion", "", 1.0),
        (r"time", "time", "min", 1 / 60),
        (r"pose", "order of measurement", "", 1.0),
        (r"qd", "speed", "", 1.0),
        (r"qd(E?\d+)", "speed of {}", "°/s", 180 / np.pi),
        (r"tau(E?\d+)", "motor torque of {}", "N·m", 1.0),
        (r"([xyz])", "position in the view along {}", "mm", 1.0),
        (r"tilt", "tilt of the artefact in the view", "°", 180 / np.pi),
        (r"payload_kg", "payload", "kg", 1.0),
        (r"(.+)_C", "temperature {}", "°C", 1.0),
    ):
        if match := re.fullmatch(pattern, depends_on):
            return label.format(*map(axis_of_tag, match.groups())).replace("_", " "), unit, factor
    return depends_on.replace("_", " "), "", 1.0


@dataclass(frozen=True)
class DrawnEffect:
    """An effect of a fit, its coefficients (k,) and their covariance (k, k). order: periods a turn of a periodic function of an angle."""

    name: str
    at: str
    depends_on: str
    parts: Sequence[Part]
    coefficients: np.ndarray
    covariance: np.ndarray
    order: float | None = None


def drawn_effects(full: ModelFit) -> Iterator[DrawnEffect]:
    """Parametric effects, and unmodelled ones by location and covariate."""
    model = full.model
    for m, p in zip(model.members, model.slices(), strict=True):
        candidate, hyper = m.candidate, m.hyper
        order = hyper if candidate.periodic else None
        about = candidate.name, "+".join(candidate.where), candidate.depends_on
        parts = candidate_parts(full.geometry_only.linear, candidate, hyper)
        yield DrawnEffect(*about, parts, model.coefficients[p], model.covariance[p, p], order)
    if full.random:
        coefficients, covariance = full.random_effects
        for group, p in zip(full.random, coefficients_of(full.random), strict=True):
            yield DrawnEffect(UNKNOWN, group.location, group.depends_on, group.parts, coefficients[p], covariance[p, p])


def response_curves(context: Context, full: ModelFit, residual: np.ndarray) -> list[dict[str, Any]]:
    """The two parts of each effect that move most, as curves of the JSON object, largest displacement first.

    residual: (M, R) mm after all effects.
    """
    linear = full.geometry_only.linear
    out = []
    for effect in drawn_effects(full):
        x = at_centres(context, effect.depends_on)
        parts = [(rms_of(linear, part, effect), part) for part in effect.parts if part.place != "ball" and x is not None]
        out += [(rms, effect, part, x) for rms, part in sorted(parts, key=lambda item: -item[0])[:2]]
    largest = sorted(out, key=lambda item: -item[0])[:MOST_CURVES]
    return [response_curve(linear, residual, effect, part, x) for _, effect, part, x in largest]


def rms_of(linear: LinearProblem, part: Part, effect: DrawnEffect) -> float:
    """Rms displacement (mm) of the kept centres by a part of an effect."""
    return float(np.sqrt(np.mean(linear.displacement([part], effect.coefficients)[linear.keep, :3] ** 2)))


def response_curve(linear: LinearProblem, residual: np.ndarray, effect: DrawnEffect, part: Part, x: np.ndarray) -> dict[str, Any]:
    """One curve over the values x (M,) of the covariate; y, std: size of the part by the model, with its standard deviation; seen: that
    and the residual of each pose (or centre) by itself.
    """
    amount, keep, pose = part.basis @ effect.coefficients, linear.keep, linear.obs.pose
    std = np.sqrt(np.maximum(np.sum(part.basis @ effect.covariance * part.basis, axis=1), 0.0))
    unit = linear.unit(part.place, part.index, part.component)
    top, bottom = np.sum(unit * residual, axis=1) * keep, np.sum(unit * unit, axis=1) * keep
    if part.place in PER_POSE:
        P = linear.obs.n_poses
        top, bottom = np.bincount(pose, top, P), np.bincount(pose, bottom, P)
        x = np.bincount(pose, x * keep, P) / np.maximum(np.bincount(pose, keep, P), 1)
    good = bottom > 1e-3 * np.median(bottom[bottom > 0]) if np.any(bottom > 0) else bottom > 0
    x, amount, std, seen = x[good], amount[good], std[good], amount[good] + top[good] / bottom[good]

    x_label, x_unit, factor = axis_of(effect.depends_on)
    if effect.order is not None and effect.order > FOLDED:
        x_label, x = f"phase of {effect.at}'s {effect.order:.5g} waves a turn", in_degrees(np.mod(x * effect.order, 2 * np.pi))
    else:
        x = factor * x
    order = np.argsort(x, kind="stable")
    order = order[:: len(order) // MOST_POINTS + 1]
    what, unit_name, scale = _axis_label(part, effect.at)
    of = {"effect": effect.name, "at": effect.at, "what": what, "unit": unit_name, "depends_on": effect.depends_on}
    curves = {name: _short(scale * values[order]) for name, values in (("y", amount), ("std", std), ("seen", seen))}
    return {**of, "x_label": x_label, "x_unit": x_unit, "x": _short(x[order]), **curves}


def _axis_label(part: Part, at: str) -> tuple[str, str, float]:
    """Label of the y axis, unit, and factor to the unit."""
    rotation = part.place in ("joint", "orientation") or part.component >= 3
    name, scale = ("µrad", 1e6) if rotation else ("µm", 1e3)
    axis = "xyz"[part.component % 3]
    if part.place == "joint":
        return f"rotation of {at}", name, scale
    if part.place == "orientation":
        return f"measured orientation about {axis}", name, scale
    if part.place == "point":
        return f"measured point along {axis}", name, scale
    return (f"rotation of {at} about {axis}" if rotation else f"shift of {at} along {axis}"), name, scale


def _short(values: np.ndarray) -> list:
    """The values with six significant digits, which is enough for any picture and a third of the size."""
    values = np.asarray(values, dtype=float)
    with np.errstate(all="ignore"):
        size = np.where(values == 0, 1.0, 10.0 ** (5 - np.floor(np.log10(np.abs(values)))))
    return np.where(np.isfinite(size), np.round(values * size) / size, values).tolist()
