"""The shape of each effect found: how much its place moves over what it depends on, with a band, and what each pose says by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.estimation.terms import PER_POSE, Part

MOST = 12
AXES = "xyz"


@dataclass(frozen=True)
class ResponseCurve:
    """x (k,): values of ``depends_on``; y, std (k,): what the model moves and its standard deviation, in ``unit``; seen (k,): the same
    from the residual of each pose (or centre) by itself, model included; what: words for the y axis. order: periods a turn of a periodic
    function of a joint's angle."""

    effect: str
    at: str
    what: str
    unit: str
    depends_on: str
    x: np.ndarray
    y: np.ndarray
    std: np.ndarray
    seen: np.ndarray
    order: float | None = None


def curves(
    linear: LinearProblem, values: dict[str, np.ndarray], model, rest: RandomEffectsModel | None, screen, left: np.ndarray
) -> list[ResponseCurve]:
    """linear: of the fit; values: covariate -> (M,) at each centre; model: named effects (``explain.Model``); rest: smooth model with the
    ``screen`` it was fitted beyond; left: (M, R) mm what all of them leave. The largest first."""
    out: list[tuple[float, ResponseCurve]] = []
    for (candidate, hyper), p in zip(model.effects, model.slices(), strict=True):
        coefficients, covariance = model.coefficients[p], model.covariance[p, p]
        sized = []
        for part in candidate.build(hyper):
            if part.place == "ball" or candidate.depends_on not in values:
                continue
            unit = linear.unit(part.place, part.index, part.component)
            amount = part.basis @ coefficients
            moved = unit * (amount[linear.obs.pose] if part.place in PER_POSE else amount)[:, None]
            sized.append((float(np.sqrt(np.mean(moved[linear.keep, :3] ** 2))), part, unit, amount))
        for size, part, unit, amount in sorted(sized, key=lambda item: -item[0])[:2]:
            std = np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", part.basis, covariance, part.basis), 0.0))
            at = "+".join(candidate.where)
            curve = _of_part(linear, part, candidate, at, unit, amount, std, values[candidate.depends_on], left)
            wave = candidate.hyper is not None and candidate.hyper.name == "order"
            out.append((size, replace(curve, order=float(hyper)) if wave else curve))
    if rest is not None:
        out += _of_groups(linear, rest, screen, values, left)
    return [curve for _, curve in sorted(out, key=lambda item: -item[0])][:MOST]


def _of_part(
    linear: LinearProblem,
    part: Part,
    candidate,
    at: str,
    unit: np.ndarray,
    amount: np.ndarray,
    std: np.ndarray,
    values: np.ndarray,
    left: np.ndarray,
) -> ResponseCurve:
    turn = part.place == "joint" or part.component >= 3
    scale, name = (1e6, "µrad") if turn else (1e3, "µm")
    if part.place == "joint":
        what = f"turn of A{part.index + 1}"
    elif part.place == "point":
        what = f"measured point along {AXES[part.component]}"
    else:
        what = f"{'turn' if turn else 'shift'} of {at} {'about' if turn else 'along'} {AXES[part.component % 3]}"
    keep, pose = linear.keep, linear.obs.pose
    top, bottom = np.sum(unit * left, axis=1) * keep, np.sum(unit * unit, axis=1) * keep
    if part.place in PER_POSE:
        P = linear.obs.n_poses
        top, bottom = np.bincount(pose, top, P), np.bincount(pose, bottom, P)
        x = np.bincount(pose, values * keep, P) / np.maximum(np.bincount(pose, keep, P), 1)
    else:
        x = values
    good = bottom > 1e-3 * np.median(bottom[bottom > 0]) if np.any(bottom > 0) else bottom > 0
    seen = amount[good] + top[good] / bottom[good]
    return ResponseCurve(
        candidate.name, at, what, name, candidate.depends_on, x[good], scale * amount[good], scale * std[good], scale * seen
    )


def _of_groups(
    linear: LinearProblem, rest: RandomEffectsModel, screen, values: dict[str, np.ndarray], left: np.ndarray
) -> list[tuple[float, ResponseCurve]]:
    """What each smooth group moves, as it is seen along the axis of the instrument along which it moves most."""
    X = screen.whiten(rest.columns)
    taken = screen.all_projected.T @ X
    precision = X.T @ X - taken.T @ taken + np.diag(1.0 / np.maximum(rest.sigma, 1e-12) ** 2)
    covariance = np.linalg.pinv(precision, hermitian=True)
    out, keep, pose, P = [], linear.keep, linear.obs.pose, linear.obs.n_poses
    count = np.bincount(pose, keep, P)
    for group, p in zip(rest.groups, rest.slices(), strict=True):
        x = values.get(group.depends_on)
        if x is None:
            continue
        moved = group.columns @ rest.coefficients[p]
        axis = int(np.argmax(np.var(moved[keep, :3], axis=0)))
        size = float(np.sqrt(np.mean(moved[keep, :3] ** 2)))
        columns = _mean(group.columns[:, axis] * keep[:, None], pose, count)
        amount = _mean((moved[:, axis] * keep)[:, None], pose, count)[:, 0]
        seen = amount + _mean((left[:, axis] * keep)[:, None], pose, count)[:, 0]
        std = np.sqrt(np.maximum(np.einsum("pi,ij,pj->p", columns, covariance[p, p], columns), 0.0))
        at = _mean((x * keep)[:, None], pose, count)[:, 0]
        good = count > 0
        out.append(
            (
                size,
                ResponseCurve(
                    "unknown",
                    group.location,
                    f"balls seen along {AXES[axis]}",
                    "µm",
                    group.depends_on,
                    at[good],
                    1e3 * amount[good],
                    1e3 * std[good],
                    1e3 * seen[good],
                ),
            )
        )
    return out


def _mean(rows: np.ndarray, pose: np.ndarray, count: np.ndarray) -> np.ndarray:
    """(M, k) -> (P, k): means over the kept centres of each pose."""
    total = np.stack([np.bincount(pose, column, len(count)) for column in rows.T], axis=1)
    return total / np.maximum(count, 1)[:, None]
