"""Inertial parameters that a body can have.

A rigid body's pseudo-inertia [[S, h], [h^T, m]] is positive definite, with S the second moment of its mass, S = trace(I) / 2 - I. See
Wensing, Kim, Slotine, Linear matrix inequalities for physically consistent inertial parameter identification, 2018. Here it is L L^T of a
lower triangular L, so that the least squares of the torque are solved within that set; rotors are squares for the same reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares

from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.effects import catalogue
from mbcacq.geometry.dynamics import inertial_sigma, nominal_parameters

BODY = 10
TENSOR = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # order of the tensor's entries in geometry.dynamics.INERTIAL
LOWER = np.tril_indices(4)
TOLERANCE = 1e-7  # relative, of the smallest eigenvalue of a pseudo-inertia
LEAST = 1e-6  # kg m^2 and kg, of an eigenvalue: a body has some extent in every direction
START = 1e-3  # kg m^2 and kg added to the bodies at which the solver begins: at a factor of zero the derivative is zero
ROUNDS = 200  # of the solver; it stops earlier where it converges


@dataclass(frozen=True)
class InertialBodies:
    """The links of the description, then the tool that was found, if any.

    Attributes
    ----------
    described : ndarray
        (b, 10) parameters of the description.
    scale : ndarray
        (b, 10) of one unit of a coefficient, zero where a parameter is not free.
    at : ndarray
        (b, 10) positions of the coefficients among those chosen, -1 where not free.
    rotors : ndarray
        Positions of the rotors' coefficients.
    """

    described: np.ndarray
    scale: np.ndarray
    at: np.ndarray
    rotors: np.ndarray

    def parameters(self, x: np.ndarray) -> np.ndarray:
        """(b, 10) from the coefficients x of the columns chosen."""
        return self.described + np.where(self.at >= 0, self.scale * x[np.maximum(self.at, 0)], 0.0)


def bodies(model: MotionModel, chosen: np.ndarray) -> InertialBodies | None:
    """The bodies of a model of torques; None for another channel."""
    robot = model.runs[0].robot
    if model.group.name != "tau" or robot is None:
        return None
    position = model.store.positions(chosen)
    sigma, J, n = inertial_sigma(robot), len(model.group.joints), robot.n
    described = nominal_parameters(robot.mass, robot.com, robot.payload_mass, robot.payload_com)
    at = np.full(sigma.shape, -1)
    base = model.store.base
    at[sigma > 0] = position[base[J : len(base) - n]]
    for effect in model.selected:
        if catalogue.declaration(effect.candidate.name).adds_body:
            described = np.concatenate([described, np.zeros((1, BODY))])
            sigma = np.concatenate([sigma, np.ones((1, BODY))])
            at = np.concatenate([at, position[effect.columns][None]])
    return InertialBodies(described, sigma, at, position[base[len(base) - n :]])


def pseudo_inertia(parameters: np.ndarray) -> np.ndarray:
    """(b, 4, 4) from inertial parameters (b, 10) in the order of ``geometry.dynamics.INERTIAL``."""
    out = np.zeros((len(parameters), 4, 4))
    tensor = np.zeros((len(parameters), 3, 3))
    for k, (i, j) in enumerate(TENSOR, start=4):
        tensor[:, i, j] = tensor[:, j, i] = parameters[:, k]
    out[:, :3, :3] = 0.5 * np.trace(tensor, axis1=1, axis2=2)[:, None, None] * np.eye(3) - tensor
    out[:, :3, 3] = out[:, 3, :3] = parameters[:, 1:4]
    out[:, 3, 3] = parameters[:, 0]
    return out


def _from_pseudo_inertia(P: np.ndarray) -> np.ndarray:
    """(b, 10) from pseudo-inertias (b, 4, 4); linear in them."""
    second = P[:, :3, :3]
    tensor = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    return np.concatenate([P[:, 3, 3:], P[:, :3, 3], np.stack([tensor[:, i, j] for i, j in TENSOR], axis=1)], axis=1)


def is_consistent(parameters: np.ndarray) -> np.ndarray:
    """(b,) bool: the pseudo-inertia has no negative eigenvalue."""
    values = np.linalg.eigvalsh(pseudo_inertia(parameters))
    return values[:, 0] >= -TOLERANCE * np.maximum(np.abs(values).max(axis=1), 1e-300)


def consistent_coefficients(model: MotionModel, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The coefficients x (c,) of the columns ``chosen``, or the nearest, in the least squares of the torque, whose bodies can all exist."""
    found = bodies(model, chosen)
    if found is None:
        return x
    if bool(is_consistent(found.parameters(x)).all()) and bool((x[found.rotors] >= 0).all()):
        return x
    free = found.at >= 0
    inertial = np.concatenate([found.at[free], found.rotors])
    others = np.setdiff1d(np.arange(len(chosen)), inertial)
    N = model.store.normal(weights)[np.ix_(chosen, chosen)]
    N[np.diag_indices_from(N)] += 1.0 / np.array(model.store.prior)[chosen] ** 2
    scale = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
    N *= np.outer(scale, scale)
    N[np.diag_indices_from(N)] += 1e-10  # what the data do not determine is held by a ridge
    A, B, C = N[np.ix_(inertial, inertial)], N[np.ix_(inertial, others)], N[np.ix_(others, others)]
    lower = cholesky(C, lower=True)
    half = solve_triangular(lower, B.T, lower=True)
    root = cholesky(A - half.T @ half + 1e-12 * np.eye(len(inertial)))
    solved = _solve(found, free, root / scale[inertial], x[inertial])
    step = solve_triangular(lower.T, -half @ ((solved - x[inertial]) / scale[inertial]))
    out = x.copy()
    out[inertial] = solved
    out[others] += step * scale[others]
    return out


def _solve(found: InertialBodies, free: np.ndarray, root: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Coefficients of the free inertial parameters and the rotors that minimise |root (z - target)| among those of bodies that exist."""
    b, r = len(found.described), len(found.rotors)
    scale, described = found.scale[free], found.described[free]

    def coefficients(y: np.ndarray) -> np.ndarray:
        L = np.zeros((b, 4, 4))
        L[:, *LOWER] = y[: b * BODY].reshape(b, BODY)
        parameters = _from_pseudo_inertia(L @ np.swapaxes(L, 1, 2) + LEAST * np.eye(4))
        return np.concatenate([(parameters[free] - described) / scale, y[b * BODY :] ** 2])

    def jacobian(y: np.ndarray) -> np.ndarray:
        L = np.zeros((b, 4, 4))
        L[:, *LOWER] = y[: b * BODY].reshape(b, BODY)
        full = np.zeros((b, BODY, b, BODY))
        for k, (i, j) in enumerate(zip(*LOWER, strict=True)):
            D = np.zeros((b, 4, 4))
            D[:, i] = L[:, :, j]
            rate = _from_pseudo_inertia(D + np.swapaxes(D, 1, 2))
            full[np.arange(b), :, np.arange(b), k] = rate
        out = np.zeros((int(free.sum()) + r, b * BODY + r))
        out[: int(free.sum()), : b * BODY] = full.reshape(b, BODY, b * BODY)[free] / scale[:, None]
        out[int(free.sum()) :, b * BODY :] = np.diag(2.0 * y[b * BODY :])
        return np.asarray(root @ out)

    # From the description the factors of a tool would begin near zero, where squares are flat: after all rounds it weighed 1 kg of 40.
    unconstrained = found.described.copy()
    unconstrained[free] += scale * target[: len(scale)]
    start = np.linalg.cholesky(_nearest(pseudo_inertia(unconstrained)) + START * np.eye(4))
    first = np.concatenate([start[:, *LOWER].ravel(), np.sqrt(np.maximum(target[len(scale) :], 0.0)) + START])
    derivative: Any = jacobian  # scipy's stubs know only the names of its own methods
    result = least_squares(lambda y: root @ (coefficients(y) - target), first, jac=derivative, method="trf", max_nfev=ROUNDS)
    return coefficients(result.x)


def _nearest(P: np.ndarray) -> np.ndarray:
    """The nearest positive semidefinite matrices (b, 4, 4)."""
    values, vectors = np.linalg.eigh(P)
    return (vectors * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(vectors, 1, 2)
