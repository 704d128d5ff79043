"""Response curves: how much each found effect displaces its location over its covariate, with a band, and what each pose shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.effects.effect import Candidate
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.terms import PER_POSE, Part

MOST = 12
AXES = "xyz"


@dataclass(frozen=True)
class ResponseCurve:
    """What an effect does over its covariate.

    x (k,): values of ``depends_on``. y, std (k,): displacement by the model and its standard deviation, in ``unit``. measured (k,): the
    displacement by the model plus the residual of each pose (or centre) by itself. what: label of the y axis. order: periods a turn of
    a periodic function of a joint's angle.
    """

    effect: str
    at: str
    what: str
    unit: str
    depends_on: str
    x: np.ndarray
    y: np.ndarray
    std: np.ndarray
    measured: np.ndarray
    order: float | None = None


def response_curves(
    linear: LinearProblem, values: dict[str, np.ndarray], model: EffectSet, rest: RandomEffectsModel | None, residual: np.ndarray
) -> list[ResponseCurve]:
    """The curves of all effects of a fit, largest displacement first, at most MOST.

    linear: of the fit. values: covariate -> (M,) at each centre. model: parametric effects. rest: unmodelled effects.
    residual: (M, R) mm after all of them.
    """
    fitted = _Fitted(linear, values, residual)
    out = [entry for j in range(len(model.effects)) for entry in _of_effect(fitted, model, j)]
    if rest is not None:
        out += _of_groups(fitted, rest)
    return [curve for _, curve in sorted(out, key=lambda item: -item[0])][:MOST]


@dataclass(frozen=True)
class _Fitted:
    """The linearised problem, (M,) values of each covariate, and (M, R) mm residuals after all effects."""

    linear: LinearProblem
    values: dict[str, np.ndarray]
    residual: np.ndarray


@dataclass(frozen=True)
class _MovedPart:
    """A part of an effect: unit, (M, R) mm displacement of the centres by a unit of it; amount, its size by the model at each row of the
    basis; rms of the displacement of the kept centres, mm.
    """

    part: Part
    unit: np.ndarray
    amount: np.ndarray
    rms: float


def _of_effect(fitted: _Fitted, model: EffectSet, j: int) -> list[tuple[float, ResponseCurve]]:
    """The two parts of a parametric effect that move most."""
    (candidate, hyper), p = model.effects[j], model.slices()[j]
    if candidate.depends_on not in fitted.values:
        return []
    linear, coefficients, covariance = fitted.linear, model.coefficients[p], model.covariance[p, p]
    parts = []
    for part in candidate.build(hyper):
        if part.place == "ball":
            continue
        unit = linear.unit(part.place, part.index, part.component)
        amount = part.basis @ coefficients
        moved = unit * (amount[linear.obs.pose] if part.place in PER_POSE else amount)[:, None]
        parts.append(_MovedPart(part, unit, amount, float(np.sqrt(np.mean(moved[linear.keep, :3] ** 2)))))
    periodic = candidate.hyper is not None and candidate.hyper.name == "order"
    out = []
    for moved in sorted(parts, key=lambda m: -m.rms)[:2]:
        basis = moved.part.basis
        std = np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", basis, covariance, basis), 0.0))
        curve = _of_part(fitted, moved, candidate, std)
        out.append((moved.rms, replace(curve, order=hyper) if periodic else curve))
    return out


def _of_part(fitted: _Fitted, moved: _MovedPart, candidate: Candidate, std: np.ndarray) -> ResponseCurve:
    linear, unit, amount = fitted.linear, moved.unit, moved.amount
    keep, pose, x = linear.keep, linear.obs.pose, fitted.values[candidate.depends_on]
    top, bottom = np.sum(unit * fitted.residual, axis=1) * keep, np.sum(unit * unit, axis=1) * keep
    if moved.part.place in PER_POSE:
        P = linear.obs.n_poses
        top, bottom = np.bincount(pose, top, P), np.bincount(pose, bottom, P)
        x = np.bincount(pose, x * keep, P) / np.maximum(np.bincount(pose, keep, P), 1)
    good = bottom > 1e-3 * np.median(bottom[bottom > 0]) if np.any(bottom > 0) else bottom > 0
    measured = amount[good] + top[good] / bottom[good]
    at = "+".join(candidate.where)
    what, name, scale = _axis_label(moved.part, at)
    return ResponseCurve(
        candidate.name, at, what, name, candidate.depends_on, x[good], scale * amount[good], scale * std[good], scale * measured
    )


def _axis_label(part: Part, at: str) -> tuple[str, str, float]:
    """Label of the y axis, unit, and factor to the unit."""
    rotation = part.place in ("joint", "orientation") or part.component >= 3
    name, scale = ("µrad", 1e6) if rotation else ("µm", 1e3)
    if part.place == "joint":
        return f"rotation of A{part.index + 1}", name, scale
    axis = AXES[part.component % 3]
    if part.place == "orientation":
        return f"measured orientation about {axis}", name, scale
    if part.place == "point":
        return f"measured point along {axis}", name, scale
    return (f"rotation of {at} about {axis}" if rotation else f"shift of {at} along {axis}"), name, scale


def _of_groups(fitted: _Fitted, rest: RandomEffectsModel) -> list[tuple[float, ResponseCurve]]:
    """What each group of the unmodelled effects moves, along the axis of the instrument along which it moves most."""
    linear = fitted.linear
    keep, pose = linear.keep, linear.obs.pose
    moved = []
    for g, (group, p) in enumerate(zip(rest.groups, rest.slices(), strict=True)):
        if group.depends_on in fitted.values:
            by_group = linear.displacement(group.parts, rest.coefficients[p])[:, :3]
            axis = int(np.argmax(np.var(by_group[keep], axis=0)))
            moved.append((float(np.sqrt(np.mean(by_group[keep] ** 2))), g, axis, by_group[:, axis]))
    count = np.bincount(pose, keep, linear.obs.n_poses)
    good, out = count > 0, []
    for size, g, axis, along in sorted(moved, key=lambda m: -m[0])[:MOST]:
        group, p = rest.groups[g], rest.slices()[g]
        each = np.stack([along, fitted.residual[:, axis], fitted.values[group.depends_on]], axis=1)
        amount, left, x = _mean(each * keep[:, None], pose, count)[good].T
        columns = _mean(linear.columns(group.parts, slice(axis, axis + 1))[:, 0] * keep[:, None], pose, count)[good]
        std = np.sqrt(np.maximum(np.einsum("pi,pi->p", columns @ rest.covariance[p, p], columns), 0.0))
        what = f"balls seen along {AXES[axis]}"
        curve = ResponseCurve("unknown", group.location, what, "µm", group.depends_on, x, 1e3 * amount, 1e3 * std, 1e3 * (amount + left))
        out.append((size, curve))
    return out


def _mean(rows: np.ndarray, pose: np.ndarray, count: np.ndarray) -> np.ndarray:
    """(M, k) -> (P, k): means over the kept centres of each pose."""
    total = np.stack([np.bincount(pose, column, len(count)) for column in rows.T], axis=1)
    return total / np.maximum(count, 1)[:, None]
