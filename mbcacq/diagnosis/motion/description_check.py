"""Does another reading of the angles, torques or gravity explain the torque better than the description does?

Signs, offsets of quarter turns (a robot counted from another pose), radians, exchanged columns and the direction of gravity are tried on a
few hundred samples. The model is that of the diagnosis in short: the described arm, its masses free within their prior, a tool, a balancer,
friction, rotors and small offsets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, product

import numpy as np

from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects.motion_effect import MotionSignals
from mbcacq.geometry.dynamics import inertial_sigma, nominal_parameters, regressor, tool_sigma
from mbcacq.model.cell import RobotModel
from mbcacq.quantities import in_degrees

QUARTER, EVERY = np.pi / 2, slice(None)
FEW_RADIANS = 7.0  # deg; angles that stay below may be in radians
DOWN = {
    "up, as for an arm on the ceiling": (0.0, 0.0, 1.0),
    "along +x": (1.0, 0.0, 0.0),
    "along -x": (-1.0, 0.0, 0.0),
    "along +y": (0.0, 1.0, 0.0),
    "along -y": (0.0, -1.0, 0.0),
}
FRICTION_SPEED = 0.02  # share of a joint's fastest speed over which friction changes its sign here


@dataclass(frozen=True)
class Samples:
    """All recordings, one after the other: q, qd, qdd, torque, moving (N, n); moving: where friction is not that of standstill. gravity:
    (3,) its direction in the base.
    """

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    torque: np.ndarray
    moving: np.ndarray
    gravity: np.ndarray


Reading = tuple[str, Callable[[Samples], Samples]]  # in words, after 'with'; the samples so read


def suspicions(runs: tuple[MotionSignals, ...]) -> tuple[str, ...]:
    """The reading that explains the torque much better than the description, in words; none where the description is the best, or no
    torque or no masses are known."""
    robot = runs[0].robot
    if robot is None or not robot.mass.any() or any(run.torque is None or not np.isfinite(run.torque).all() for run in runs):
        return ()
    samples = _samples(runs, robot)
    described = _unit_torques(samples, robot)
    before = _residual(samples, robot, described)
    best, after = "", before
    for what, reading in _readings(samples, robot.axes):
        read = reading(samples)
        same = read.q is samples.q and read.gravity is samples.gravity
        rms = _residual(read, robot, described if same else _unit_torques(read, robot))
        if float(np.log(rms).sum()) < float(np.log(after).sum()):
            best, after = what, rms
    if not best:
        return ()
    ratio = after / before
    if float(np.prod(ratio)) > NUMBERS.suspicious_ratio:
        return ()
    j = int(np.argmin(ratio))
    return (f"with {best} the torque that is not explained falls from {before[j]:.0f} to {after[j]:.0f} N m at {robot.axes[j]}",)


def _samples(runs: tuple[MotionSignals, ...], robot: RobotModel) -> Samples:
    each = max(NUMBERS.description_samples // len(runs), 1)
    columns: list[list[np.ndarray]] = [[] for _ in range(4)]
    for run in runs:
        edge = int(np.ceil(NUMBERS.edge_s / run.step_s))
        at = np.linspace(edge, len(run.q) - 1 - edge, min(each, len(run.q) - 2 * edge)).astype(int)
        for column, signal in zip(columns, (run.smooth, run.qd, run.qdd, run.torque), strict=True):
            column.append(np.asarray(signal)[at])
    q, qd, qdd, torque = (np.concatenate(c) for c in columns)
    return Samples(q, qd, qdd, torque, np.abs(qd) > NUMBERS.standstill * np.abs(qd).max(axis=0), robot.gravity)


def _readings(samples: Samples, axes: tuple[str, ...]) -> Iterator[Reading]:
    n = samples.q.shape[1]
    each = np.eye(n)
    for j, flip in enumerate(1.0 - 2.0 * each):
        yield f"{axes[j]} reversed", partial(_angles, sign=flip)
        yield f"the torque of {axes[j]} reversed", partial(_torques, sign=flip)
        yield f"{axes[j]} and its torque reversed", lambda s, flip=flip: _torques(_angles(s, flip), flip)
    yield "all axes reversed", partial(_angles, sign=-1.0)
    yield "all torques reversed", partial(_torques, sign=-1.0)
    yield "all axes and torques reversed", lambda s: _torques(_angles(s, -1.0), -1.0)
    for j in range(n):
        for quarter in (1, -1, 2):
            yield f"{90 * quarter:+d}° added to {axes[j]}", partial(_angles, offset=quarter * QUARTER * each[j])
    for a, b in product((1, -1), (1, -1)) if n >= 3 else ():
        yield (
            f"{90 * a:+d}° added to {axes[1]} and {90 * b:+d}° to {axes[2]}",
            partial(_angles, offset=QUARTER * (a * each[1] + b * each[2])),
        )
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        yield f"the columns of {axes[i]} and {axes[j]} exchanged", lambda s, order=order: _torques(_angles(s, order=order), order=order)
        yield f"the torques of {axes[i]} and {axes[j]} exchanged", partial(_torques, order=order)
    if in_degrees(np.abs(samples.q)).max() < FEW_RADIANS:
        yield "the angles read as radians, not degrees", partial(_angles, sign=float(in_degrees(1)))
    for what, down in DOWN.items():
        yield f"gravity {what}", lambda s, down=down: replace(s, gravity=np.array(down))


def _angles(s: Samples, sign: np.ndarray | float = 1.0, offset: np.ndarray | float = 0.0, order: np.ndarray | slice = EVERY) -> Samples:
    q, qd, qdd = (sign * signal[:, order] for signal in (s.q, s.qd, s.qdd))
    return replace(s, q=q + offset, qd=qd, qdd=qdd, moving=s.moving[:, order])


def _torques(s: Samples, sign: np.ndarray | float = 1.0, order: np.ndarray | slice = EVERY) -> Samples:
    return replace(s, torque=sign * s.torque[:, order])


def _unit_torques(s: Samples, robot: RobotModel) -> np.ndarray:
    """(N, n, n, 10) by unit inertial parameters. They take most of the time, and readings of the torque alone share them."""
    return regressor(robot.chain, s.q, s.qd, s.qdd, s.gravity)


def _residual(s: Samples, robot: RobotModel, unit: np.ndarray) -> np.ndarray:
    """(n,) rms of the torque that a regularised least-squares fit of the arm leaves. unit: torques by unit inertial parameters."""
    N, n = s.q.shape
    nominal = nominal_parameters(robot.mass, robot.com, robot.payload_mass, robot.payload_com)
    mismatch = s.torque - np.einsum("tjlk,lk->tj", unit, nominal)
    sigma = inertial_sigma(robot)
    common = np.concatenate([(unit * sigma)[:, :, sigma > 0], unit[:, :, -1] * np.array(tool_sigma(robot))], axis=2)
    largest = np.maximum(np.abs(s.torque).max(axis=0), 1e-12)
    fastest = np.maximum(np.abs(s.qd).max(axis=0), 1e-9)
    own = np.zeros((N, n, 6))
    own[:, :, 0] = NUMBERS.torque_offset * largest
    own[:, :, 1], own[:, :, 2] = largest * np.tanh(s.qd / (FRICTION_SPEED * fastest)), largest * s.qd / fastest
    own[:, :, 3] = largest * s.qdd / np.maximum(np.abs(s.qdd).max(axis=0), 1e-9)
    own[:, 1, 4], own[:, 1, 5] = largest[1] * np.sin(s.q[:, 1]), largest[1] * np.cos(s.q[:, 1])  # a balancer
    weight = 1.0 / np.maximum(mismatch.std(axis=0), 1e-9)
    rms = mismatch.std(axis=0)
    for _ in range(NUMBERS.weight_rounds):
        rms = _fit(mismatch, common, own, s.moving, weight / np.sqrt(NUMBERS.description_correlated))
        weight = 1.0 / np.maximum(rms, 1e-9)
    return rms


def _fit(mismatch: np.ndarray, common: np.ndarray, own: np.ndarray, moving: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n,) rms after a fit of common columns (N, n, c) and each joint's own (N, n, k), all with prior sigma 1; weight: (n,)."""
    n, c, k = mismatch.shape[1], common.shape[2], own.shape[2]
    A, g = np.eye(c + n * k), np.zeros(c + n * k)
    blocks = []
    for j in range(n):
        use = moving[:, j]
        at = np.r_[np.arange(c), c + k * j + np.arange(k)]
        Z = np.concatenate([common[use, j], own[use, j]], axis=1)
        A[np.ix_(at, at)] += weight[j] ** 2 * Z.T @ Z
        g[at] += weight[j] ** 2 * Z.T @ mismatch[use, j]
        blocks.append((Z, at, use))
    x = np.linalg.solve(A, g)
    return np.array([float(np.sqrt(np.mean((mismatch[use, j] - Z @ x[at]) ** 2))) for j, (Z, at, use) in enumerate(blocks)])
