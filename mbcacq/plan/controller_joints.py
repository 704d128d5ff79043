"""Joint angles as the arm's own controller counts them, and as the robot file does."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.plan.planned import LoadedPlan
from mbcacq.plan.schema import ControllerJoints
from mbcacq.quantities import from_degrees


def to_controller(loaded: LoadedPlan, q: np.ndarray) -> np.ndarray:
    """Positions (..., n) deg, mm as the controller counts them, of q (..., n) rad, mm. Raises ConfigError, see ``matrix``."""
    A, offset = matrix(loaded)
    return loaded.cell.robot.shown(q) @ A.T + offset


def from_controller(loaded: LoadedPlan, positions: np.ndarray) -> np.ndarray:
    """The inverse: (..., n) rad, mm. Raises ConfigError, see ``matrix``."""
    return of_the_model(positions, *matrix(loaded), loaded.cell.robot.chain.prismatic)


def of_the_model(positions: np.ndarray, A: np.ndarray, offset: np.ndarray, prismatic: np.ndarray) -> np.ndarray:
    """(..., n) rad, mm of ``positions`` (..., n) deg, mm as a controller counts them, with ``matrix``. prismatic: (n,) bool."""
    counted = np.linalg.solve(A, (np.asarray(positions, dtype=float) - offset)[..., None])[..., 0]
    return np.where(prismatic, counted, from_degrees(counted))


def matrix(loaded: LoadedPlan) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and offset (n,) deg, with angles = A q + offset. Raises ConfigError if the plan's ``controller_joints`` do not fit the
    arm."""
    return matrix_of(loaded.plan.robot.controller_joints or ControllerJoints(), loaded.cell.robot.n, partial(_error, loaded))


def matrix_of(spec: ControllerJoints, n: int, error: Callable[[str], ConfigError]) -> tuple[np.ndarray, np.ndarray]:
    """As ``matrix``, for an arm of n axes. error: makes the exception of a sentence."""
    sign = _of_every_axis(n, "sign", spec.sign, 1.0, error)
    offset = _of_every_axis(n, "offset_deg", spec.offset_deg, 0.0, error)
    couple = np.eye(n)
    for coupling in spec.couplings:
        if max(coupling.axis, coupling.of) > n or coupling.axis == coupling.of:
            raise error(f"couplings name axis {coupling.axis} and {coupling.of} of an arm with {n}; name two of its axes")
        couple[coupling.axis - 1, coupling.of - 1] += coupling.factor
    if abs(np.linalg.det(couple)) < 1e-6:
        raise error("the couplings make one angle of two, which cannot be undone; correct them")
    return couple * sign, couple @ offset


def pulses(loaded: LoadedPlan, angles_deg: np.ndarray) -> np.ndarray:
    """Encoder pulses (..., n), rounded, of angles as the controller counts them. Raises ConfigError if the plan states none."""
    spec = loaded.plan.robot.controller_joints
    if spec is None or spec.pulses_per_deg is None:
        raise _error(loaded, "pulses_per_deg are missing, which such a job needs; take them from the controller's parameters")
    per_deg = _of_every_axis(loaded.cell.robot.n, "pulses_per_deg", spec.pulses_per_deg, 0.0, partial(_error, loaded))
    if not np.all(np.isfinite(per_deg) & (per_deg != 0)):
        raise _error(loaded, "pulses_per_deg hold a zero or no number; take them from the controller's parameters")
    return np.rint(angles_deg * per_deg).astype(np.int64)


def _of_every_axis(n: int, name: str, values: tuple[float, ...] | None, default: float, error: Callable[[str], ConfigError]) -> np.ndarray:
    if values is None:
        return np.full(n, default)
    if len(values) != n:
        raise error(f"{name} has {len(values)} values for an arm of {n} axes; give one an axis")
    return np.array(values, dtype=float)


def _error(loaded: LoadedPlan, sentence: str) -> ConfigError:
    line = loaded.lines.get(("robot", "controller_joints"), loaded.lines.get(("robot",), 1))
    return ConfigError(f"{loaded.path}:{line}: robot.controller_joints: {sentence}")
