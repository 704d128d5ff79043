"""Error of the torque that passes the gears, which is itself an estimate: it belongs to the noise of every mismatch that follows the load.

The load of an explained joint is the torque of the links and of the effects behind its gear, whose coefficients have a covariance. With a
root of that, the error of the load is a sum of columns, common to all joints, with coefficients of mean 0 and standard deviation 1. On the
joint side an elastic gear passes it on as compliance times these columns. They are in the base of that channel with their prior (errors in
variables, to first order). Without them their structure would pass for an effect, and compliances for exact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.effects import catalogue
from mbcacq.effects.motion_effect import available

# Share of the error's variance of each joint that is left out. Thousands of angles show shapes of a wind-up that are a thousandth of the
# whole; with a hundredth left out, two of three short runs (benchmarks/run_and_motion.md) had a false name.
LEFT_OUT = 1e-7
LEAST_INFORMATION = 1e-3  # of a direction of the coefficients in units of their priors: below is rounding


def load_error(model: MotionModel, weights: np.ndarray) -> list[np.ndarray]:
    """(T, J, r) by run: what independent standard normal errors change of the load of each joint.

    weights: (J,) one over the variance of a sample.
    """
    group, runs = model.group, model.runs
    if group.name != "tau":
        return [np.zeros((len(run.q), len(group.joints), 0)) for run in runs]
    chosen = model.chosen()
    position = {int(number): i for i, number in enumerate(chosen)}
    links = model.store.base[len(group.joints) : -runs[0].q.shape[1]]  # the first are offsets, the last the rotors
    passed = [e for e in model.selected if not catalogue.declaration(e.candidate.name).motor_side]
    root = _root(model, weights, chosen)[[position[int(i)] for i in (*links, *(i for e in passed for i in e.columns))]]
    out = []
    for k, run in enumerate(runs):
        of_joint = []
        for j, joint in enumerate(group.joints):
            of_effects = [
                e.candidate.rows.columns(run, joint, e.hyper) if joint in e.candidate.rows.joints else np.zeros((len(run.q), e.candidate.k))
                for e in passed
            ]
            of_joint.append(np.concatenate([group.base[k][:, j, : len(links)], *of_effects], axis=1) @ root)
        out.append(np.stack(of_joint, axis=1))
    return _principal(out)


def _root(model: MotionModel, weights: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(c, c) root of the posterior covariance of the coefficients of these columns.

    The masses are known far less than the torque that they make together. So the root is that of the information, whose weakest directions
    make no torque; the inverse of a matrix would have that to its rounding only.
    """
    prior = np.array(model.store.prior)[chosen]
    information = model.store.normal(weights)[np.ix_(chosen, chosen)] + np.diag(prior**-2.0)
    scale = np.where(np.isfinite(prior), prior, 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300)))
    value, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    return scale[:, None] * vectors / np.sqrt(np.maximum(value, LEAST_INFORMATION))


def _principal(columns: list[np.ndarray]) -> list[np.ndarray]:
    """The same error of fewer columns (T, J, r), in order of their size relative to the error of each joint."""
    products = sum(np.einsum("tjr,tjs->jrs", one, one) for one in columns)
    size = np.einsum("jrr->j", products)
    together = np.einsum("jrs,j->rs", products, 1.0 / np.maximum(size, 1e-300))
    directions = np.linalg.eigh(together)[1][:, ::-1]
    kept = np.cumsum(np.einsum("rk,jrs,sk->jk", directions, products, directions), axis=1)
    enough = np.all(kept >= (1.0 - LEFT_OUT) * size[:, None], axis=0)
    most = int(np.argmax(enough)) + 1
    return [one @ directions[:, :most] for one in columns]


def follow_load_error(model: MotionModel) -> None:
    """Let the error of the load show as the selected effects pass it on."""
    if len(model.load_error):
        model.set_load_error(_passed_on(model, model.coefficients()))


def _passed_on(model: MotionModel, x: np.ndarray) -> list[np.ndarray]:
    """(Ttot, r) by joint of the group: how the error of the load shows in the mismatch through the selected effects.

    x: coefficients of ``model.chosen()``.
    """
    position = {int(number): i for i, number in enumerate(model.chosen())}
    passing = [(e.candidate.rows, x[[position[int(i)] for i in e.columns]]) for e in model.selected if e.candidate.rows.linear_in_load]
    out = []
    for joint in model.group.joints:
        by_run = [np.zeros_like(available(run.load_error)[:, 0]) for run in model.runs]
        for rows, coefficients in passing:
            if joint in rows.joints:
                for run, columns in zip(model.runs, by_run, strict=True):
                    for r in range(columns.shape[1]):
                        moved = replace(run, load=available(run.load_error)[:, :, r])
                        columns[:, r] += rows.columns(moved, joint, None) @ coefficients
        out.append(np.concatenate(by_run))
    return out
