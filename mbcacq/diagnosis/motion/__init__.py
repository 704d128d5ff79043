"""Diagnosis of recordings in time: joint-side against motor-side angle, set point against actual, torque against rigid body."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.motion.fit import MotionFit, conclude
from mbcacq.diagnosis.motion.forward_selection import ForwardSelection
from mbcacq.diagnosis.motion.normal_store import parts
from mbcacq.diagnosis.motion.result import outcome
from mbcacq.diagnosis.motion.signals import groups, prepare
from mbcacq.diagnosis.motion.torque_constants import with_torque
from mbcacq.diagnosis.motion.transmitted_torque import with_load
from mbcacq.effects.motion.effect import MotionSignals
from mbcacq.errors import ConfigError
from mbcacq.model.cell import RobotModel

WORKERS = 2
OPTIONAL = ("q_set", "qd_set", "qdd_set", "qddd_set", "q_joint", "torque", "load", "rigid", "gravity", "rigid_set", "payload", "load_doubt")


def diagnose_trajectories(trajectories: list, proof: bool = True) -> dict:
    """One mbcacq-diagnosis/1 object for one or several recordings of one robot. Raises ConfigError where they do not fit together.

    ``fit`` carries, beside the chi2 per degree of freedom over all channels, one entry a channel in that channel's own unit. Its
    held-out figures are of parts (a trajectory, or a block of the only one) that took no part in choosing or fitting anything; without
    ``proof``, in a third of the time, of parts that took part in choosing.
    """
    runs, inertial, robot = _prepared(trajectories)
    explained, loaded = explain(runs, inertial, robot)
    return outcome(explained, loaded, prove(runs, inertial, robot) if proof else None)


def explain_trajectories(trajectories: list, held: int | None = None) -> list[MotionFit]:
    """What was found in each kind of mismatch. held: a part (``ledger.parts``) that takes no part."""
    return explain(*_prepared(trajectories), held)[0]


def base_alone(trajectories: list) -> dict[str, np.ndarray]:
    """Chi2 per degree of freedom (J,) by kind of mismatch, held out, of offsets and the arm's inertial parameters: no effect is tried."""
    runs, inertial, robot = _prepared(trajectories)
    out = {}
    for group in groups(runs, inertial, robot):
        selection = ForwardSelection(group, runs, candidates=())
        out[group.name] = selection.mean_square(selection.start) / selection.floor**2
    return out


def _prepared(trajectories: list) -> tuple[tuple[MotionSignals, ...], list[np.ndarray], RobotModel]:
    if not trajectories:
        raise ConfigError("no trajectory was given")
    if len({t.robot.n for t in trajectories}) > 1:
        raise ConfigError("the trajectories belong to robots with different numbers of axes; diagnose them separately")
    prepared = [prepare(t) for t in with_torque(trajectories)]
    return _common([run for run, _ in prepared]), [inertial for _, inertial in prepared], trajectories[0].robot


def explain(
    runs: tuple[MotionSignals, ...], inertial: list[np.ndarray], robot: RobotModel, held: int | None = None
) -> tuple[list[MotionFit], tuple[MotionSignals, ...]]:
    """Torque first: the load it tells winds up the gears. Raises ConfigError where there is nothing to compare."""
    kinds = [g.name for g in groups(runs, inertial, robot)]
    if not kinds:
        raise ConfigError("nothing to compare: the trajectory needs q*_joint_deg, q*_set_deg, tau*_Nm, motor_tau*_Nm or i*_A beside q*_deg")
    explained: list[MotionFit] = []
    for kind in kinds:
        group = next(g for g in groups(runs, inertial, robot) if g.name == kind)
        explained.append(conclude(ForwardSelection(group, runs, held)))
        if kind == "tau":
            runs = with_load(runs, explained[-1])
    return explained, runs


def prove(runs: tuple[MotionSignals, ...], inertial: list[np.ndarray], robot: RobotModel) -> dict[str, np.ndarray]:
    """Mean squares (2, J) before and after by kind of mismatch, each part told from what was chosen and fitted on the others alone."""
    total: dict[str, np.ndarray] = {}
    count: dict[str, np.ndarray] = {}
    held = parts(runs)[0]
    with ThreadPoolExecutor(WORKERS) as pool:  # matrices, so threads share the work
        passes = list(pool.map(lambda number: explain(runs, inertial, robot, number)[0], range(len(held))))
    for part, explained in zip(held, passes, strict=True):
        for e in explained:
            J = len(e.group.joints)
            squares, samples = np.zeros((2, J)), np.zeros(J)
            for j in range(J):
                for k, where in part:
                    use = e.used[j][k][where]
                    for row, left in enumerate((e.before, e.after)):
                        r = left[j][k][where][use]
                        squares[row, j] += float(((r - r.mean()) ** 2).sum() if e.group.refit else r @ r) if len(r) else 0.0
                    samples[j] += int(use.sum())
            total[e.group.name] = total.get(e.group.name, 0.0) + squares
            count[e.group.name] = count.get(e.group.name, 0.0) + samples
    return {name: square / np.maximum(count[name], 1.0) for name, square in total.items()}


def _common(runs: list[MotionSignals]) -> tuple[MotionSignals, ...]:
    """Keep only the signals that every run has."""
    missing = {name: None for name in OPTIONAL if any(getattr(r, name) is None for r in runs)}
    return tuple(replace(r, **missing) for r in runs)
