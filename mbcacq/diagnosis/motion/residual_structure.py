"""What the named effects leave behind in a channel: is it noise, and if not, what does it depend on?"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from mbcacq.diagnosis.motion.fit import MotionFit
from mbcacq.diagnosis.motion.forward_selection import improvement_p
from mbcacq.effects.motion.effect import MotionSignals

BINS = 24
PIECES = 24  # of a channel's residual, taken as independent witnesses
LEAST_SHARE = 0.15  # of what is left that one variable must explain, on the other part of the data, to be worth saying
LEAST_CHI2 = 2.0


def structure(explained: MotionFit, place: int, runs: tuple[MotionSignals, ...], floor: float, weight: float) -> dict | None:
    """The covariate that predicts most of what is left of one joint, fitted on one part and tested on the other; None for noise.

    weight: share of all that was there to explain which is left at this joint.
    """
    group, joint = explained.group, explained.group.joints[place]
    used = explained.used[place]
    left = [a[u] for a, u in zip(explained.after[place], used, strict=True)]
    total = float(np.mean(np.concatenate(left) ** 2))
    if total < LEAST_CHI2 * floor**2:
        return None
    best_name, best_share, best_shape, p = "time", 0.0, None, 1.0
    covariates = _covariates(group.name, runs, joint)
    for name, values in covariates.items():
        share, shape, one = _cross_validated([v[u] for v, u in zip(values, used, strict=True)], left)
        if share > best_share:
            best_name, best_share, best_shape, p = name, share, shape, min(one * len(covariates), 1.0)
    where = {"at": f"A{joint + 1}", "channel": group.name, "depends_on": best_name, "share": best_share * weight, "p_value": p}
    if best_shape is None or best_share < LEAST_SHARE:
        rest = {"depends_on": "time", "p_value": float(chi2.sf(PIECES * total / floor**2, PIECES)), "share": weight}
        return {"mismatch": where | rest}
    effect = {
        "name": "unknown",
        "where": [f"A{joint + 1}"],
        "channel": group.name,
        "depends_on": best_name,
        "parameters": {},
        "p_value": p,
        "held_out_gain": best_share * weight,
        "shape": best_shape,
        "alternatives": [],
    }
    return {"mismatch": where, "effect": effect}


def _covariates(name: str, runs: tuple[MotionSignals, ...], joint: int) -> dict[str, list[np.ndarray]]:
    out = {f"q{k + 1}": [r.q[:, k] for r in runs] for k in range(runs[0].q.shape[1])}
    out |= {f"qd{k + 1}": [r.qd[:, k] for r in runs] for k in range(runs[0].q.shape[1])}
    out[f"qdd{joint + 1}"] = [r.qdd[:, joint] for r in runs]
    if runs[0].torque is not None and name != "tau":
        out[f"tau{joint + 1}"] = [r.torque[:, joint] for r in runs]
    return out


def _cross_validated(values: list[np.ndarray], left: list[np.ndarray]) -> tuple[float, dict | None, float]:
    """Share of the mean square that a table over the covariate (quantile bins) predicts on the other half; the table; a p-value of the
    improvement, from pieces of the residual."""
    v, r = np.concatenate(values), np.concatenate(left)
    half = (
        np.concatenate([np.arange(len(x)) * 4 // len(x) % 2 for x in values])
        if len(values) == 1
        else np.concatenate([np.full(len(x), k % 2) for k, x in enumerate(values)])
    )
    edges = np.unique(np.quantile(v, np.linspace(0, 1, BINS + 1)))
    if len(edges) < 4:
        return 0.0, None, 1.0
    bins = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, len(edges) - 2)
    predicted = np.zeros_like(r)
    for test in (0, 1):
        train = half != test
        count = np.bincount(bins[train], minlength=len(edges) - 1)
        mean = np.bincount(bins[train], r[train], minlength=len(edges) - 1) / np.maximum(count, 1)
        predicted[~train] = mean[bins[~train]]
    before, after = (np.array([np.mean(piece**2) for piece in np.array_split(x, PIECES)]) for x in (r, r - predicted))
    count = np.bincount(bins, minlength=len(edges) - 1)
    mean = np.bincount(bins, r, minlength=len(edges) - 1) / np.maximum(count, 1)
    share = 1.0 - float(((r - predicted) ** 2).sum() / (r**2).sum())
    return share, {"x": (0.5 * (edges[1:] + edges[:-1])).tolist(), "y": mean.tolist()}, improvement_p(before, after)
