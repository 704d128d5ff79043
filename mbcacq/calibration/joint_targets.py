"""Joint angles that bring the calibrated arm, with its effects, to given places: Newton's method, all points at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.geometry import se3

ROUNDS = 60
REACHED_MM = 1e-3  # a thousandth of a millimetre is below any arm's repeatability
REACHED_RAD = 1e-6
ROUNDED = 1e-6  # rad, far more than the decimals of a program leave out
LEVER_MM = 300.0  # weighs rotations against translations: a tool of that length
DAMPING = 1e-4  # relative, of directions that an arm near a singular posture can hardly move in
LARGEST_STEP = 0.2  # rad, of a joint in one round


@dataclass(frozen=True)
class JointTargets:
    """q: (P, n) rad; error_mm (P,), error_rad (P,): what is left between the flange and its goal; reached: (P,) bool; reasons: why not."""

    q: np.ndarray
    error_mm: np.ndarray
    error_rad: np.ndarray
    reached: np.ndarray
    reasons: tuple[str, ...]


def joint_targets(cell: CalibratedCell, goals: np.ndarray, start: np.ndarray, limits: np.ndarray | None = None) -> JointTargets:
    """Joint angles at which the flange of the calibrated arm stands at ``goals`` (P, 4, 4) mm in the base.

    start: (P, n) rad, from which the solution of the same branch follows. limits: (n, 2) rad that are kept. Effects count as the model has
    them at standstill; what is not known of a planned pose (direction of motion, temperature) is taken as it was on average.
    """
    limits = np.tile([-np.inf, np.inf], (start.shape[1], 1)) if limits is None else limits
    low, high = limits.T
    q = np.clip(np.array(start, dtype=float), low, high)
    weight = np.array([1.0] * 3 + [LEVER_MM] * 3)
    best, lowest = q.copy(), np.full(len(q), np.inf)
    for _ in range(ROUNDS):
        F = cell.frames(q)
        twist = se3.coordinates(se3.inverse(F[:, -1]) @ goals)  # local, to first order in the rotation
        size = np.linalg.norm(twist * weight, axis=1)
        better = size < lowest
        best[better], lowest[better] = q[better], size[better]
        if np.all(size < 1e-7):
            break
        J = cell.state.chain.joint_twists(F)
        at_flange = np.einsum("pij,pkj->pki", se3.adjoint(se3.inverse(F[:, -1])), J) * weight  # local twists of the joints
        # A joint at its limit that would be pushed beyond takes no part.
        A = np.swapaxes(at_flange, 1, 2)
        normal = np.swapaxes(A, 1, 2) @ A
        scale = np.trace(normal, axis1=1, axis2=2)[:, None, None] / q.shape[1]
        damped = normal + DAMPING**2 * scale * np.eye(q.shape[1])
        step = np.linalg.solve(damped, np.einsum("pij,pi->pj", A, twist * weight)[..., None])[..., 0]
        largest = np.abs(step).max(axis=1, keepdims=True)
        step = step * np.minimum(1.0, LARGEST_STEP / np.maximum(largest, 1e-12))
        q = np.clip(q + step, low, high)
    left = se3.coordinates(se3.inverse(cell.frames(best)[:, -1]) @ goals)
    error_mm, error_rad = np.linalg.norm(left[:, :3], axis=1), np.linalg.norm(left[:, 3:], axis=1)
    beyond = (start < low - ROUNDED) | (start > high + ROUNDED)  # a turn back it is the same place, by another motion
    reached = (error_mm < REACHED_MM) & (error_rad < REACHED_RAD) & ~beyond.any(axis=1)
    at_limit = (best <= low + 1e-9) | (best >= high - 1e-9)
    reasons = tuple("" if ok else _reason(cell, *ends) for ok, *ends in zip(reached, at_limit, beyond, strict=True))
    return JointTargets(best, error_mm, error_rad, reached, reasons)


def _reason(cell: CalibratedCell, at_limit: np.ndarray, beyond: np.ndarray) -> str:
    axes = cell.axes
    if beyond.any():
        return f"{', '.join(axes[i] for i in np.flatnonzero(beyond))} is programmed beyond its limits"
    stopped = ", ".join(axes[i] for i in np.flatnonzero(at_limit))
    return f"{stopped} stands at its limit" if stopped else "out of reach, or in a singular posture"
