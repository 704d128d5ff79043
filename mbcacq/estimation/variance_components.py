"""Noise estimated from the data: restricted maximum likelihood (REML) of variance components, with broad log-normal priors.

Components: scanner noise along each axis, turn of a measured orientation, repeatability of each joint. Stated figures are priors.
Average-information scoring (Gilmour, Thompson, Cullis 1995) on the logarithms; degrees of freedom spent on the geometry are
accounted for through the traces.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.normal_equations import Normal, PoseSystem
from mbcacq.estimation.options import Noise
from mbcacq.estimation.pose_information import flat_product
from mbcacq.model.cell import Cell

# Standard deviations of logarithms.
STATED = 0.7  # a stated instrument noise is right within a factor of two
GUESSED = 1.5  # of an instrument of which nothing is stated only the order of magnitude is known
AXIS = 0.25  # deviation of an axis of the instrument from the level that all axes share
COMMON = 1.0  # the level that all joints of an arm share
JOINT = 0.15  # deviation of a joint from that level
EXACT = 1e-3  # a figure that is taken as it is
# No instrument and no joint is better, and beyond it double precision ends: mm, rad of a joint, rad of a measured orientation.
LEAST_POINT, LEAST_JOINT, LEAST_TURN = 1e-5, 1e-9, 1e-9


@dataclass(frozen=True)
class NoisePrior:
    """Normal prior of the logarithms of (point (3), joint (n), turn (1)): centre (K,), precision (K, K)."""

    centre: np.ndarray
    precision: np.ndarray

    def log_density(self, noise: Noise) -> float:
        """Log density of a noise, up to a constant."""
        off = pack(noise) - self.centre
        return -0.5 * float(off @ self.precision @ off)


def first_noise(cell: Cell) -> Noise:
    """Stated figures, or guesses: 0.02 mm a centre, and the repeatability of the data sheet turned into angles at the arm's reach."""
    chain = cell.robot.chain
    # The height of the first axis' foot is no lever of anything.
    reach = max(float(np.abs(chain.a[0]) + np.sum(np.hypot(chain.a[1:], chain.d[1:]))), 1.0)
    point = np.full(3, 0.02) if cell.noise_mm is None else np.maximum(cell.noise_mm, LEAST_POINT)
    repeatability = cell.robot.repeatability_mm or 0.06
    # RP = mean + 3 sigma of a distance, about four times the sigma of one coordinate; half of the reach, on average, is behind a joint.
    return Noise(point, np.full(chain.n, repeatability / 4 / (0.5 * reach)), 1e-4)


def noise_prior(cell: Cell, option: str = "auto") -> NoisePrior:
    """Prior about ``first_noise``. option: 'auto', 'given' or 'estimate'.

    Joints share an unknown common level and differ from it by JOINT.
    """
    noise = first_noise(cell)
    n = len(noise.joint)
    level = {"auto": STATED, "given": EXACT, "estimate": GUESSED}[option] if cell.noise_mm is not None else GUESSED
    common, single = (EXACT, EXACT) if option == "given" and cell.robot.repeatability_mm else (COMMON, JOINT)
    precision = np.zeros((n + 4, n + 4))
    axis = EXACT if level == EXACT else AXIS
    precision[:3, :3] = np.linalg.inv(axis**2 * np.eye(3) + level**2)
    precision[3:-1, 3:-1] = np.linalg.inv(single**2 * np.eye(n) + common**2)
    precision[-1, -1] = 1 / GUESSED**2
    return NoisePrior(pack(noise), precision)


def pack(noise: Noise) -> np.ndarray:
    return np.log(np.concatenate([noise.point, noise.joint, [noise.turn]]))


def unpack(theta: np.ndarray) -> Noise:
    value = np.exp(theta)
    return Noise(value[:3], value[3:-1], float(value[-1]))


def restricted_maximum_likelihood(
    system: Callable[[Noise], PoseSystem], start: Noise, prior: NoisePrior, rounds: int = 12, tolerance: float = 0.02
) -> Noise:
    """Most probable noise of a linear problem, whose whitened system under any noise ``system`` gives."""
    noise = start
    for _ in range(rounds):
        noise, change = reml_step(system(noise), noise, prior)
        if change < tolerance:
            break
    return noise


def reml_step(system: PoseSystem, noise: Noise, prior: NoisePrior) -> tuple[Noise, float]:
    """One step of average-information scoring (REML); also the largest change of a logarithm."""
    score, information = reml_score_and_information(system, noise)
    theta = pack(noise)
    score = score - prior.precision @ (theta - prior.centre)
    step = np.linalg.solve(information + prior.precision, score)
    least = np.log(np.concatenate([np.full(3, LEAST_POINT), np.full(len(noise.joint), LEAST_JOINT), [LEAST_TURN]]))
    moved = np.maximum(theta + np.clip(step, -1.0, 1.0), least)
    return unpack(moved), float(np.abs(moved - theta).max())


def reml_score_and_information(system: PoseSystem, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (K,) and average information (K, K) of the restricted log likelihood by the log sigmas.

    From the twists of the poses; only the balls and the effects have rows of their own.
    """
    poses, rows = system.poses, system.poses.rows
    n, share = len(noise.joint), poses.share
    variance = _PoseVariance(system)
    axes = np.minimum(np.tile(np.arange(rows.width), rows.depth), 3)[:, None] == np.arange(4)  # (B R, 4): scanner's axes and turn
    # Scanner: the rows of one axis each.
    r = poses.white_residual
    Jt = np.swapaxes(poses.joints, 1, 2)
    absorbed = np.einsum("pmu,pmu->pm", poses.G @ poses.N, poses.G)
    lever = variance.of_rows()
    weight = share[:, None] * poses.centre_weight
    by_axis = (weight * (share[:, None] * (r**2 + lever) - 1 + absorbed)).sum(axis=0) @ axes
    # Joints: one column a pose.
    b = share[:, None] * poses.residual_joint
    diagonal = 1 - np.diagonal(poses.K, axis1=1, axis2=2)
    by_joint = np.sum(b**2 + share[:, None] * (share[:, None] * variance.of_joints() - diagonal), axis=0)
    score = np.concatenate([by_axis[:3], by_joint, by_axis[3:]])
    # Average information: Y' P Y of the images Y, one of each component, from products with the columns.
    image = (weight * r)[:, :, None] * axes
    image_twist = np.swapaxes(poses.G, 1, 2) @ image
    image_joint = Jt @ image_twist
    K_image = poses.K @ image_joint
    square = np.zeros((n + 4, n + 4))
    order = np.r_[:3, n + 3]
    between = np.tensordot(share[:, None, None] * image_joint, K_image, axes=([0, 1], [0, 1]))
    square[np.ix_(order, order)] = np.diag(np.einsum("p,pmc,pmc->c", share, image, image)) - between
    mixed = np.einsum("p,pj,pjc->jc", share, b, K_image)
    square[3 : n + 3, order], square[order, 3 : n + 3] = mixed, mixed.T
    square[3 : n + 3, 3 : n + 3] = np.diag(np.einsum("p,pj,pj->j", share, b, b)) - np.einsum("p,pj,pk,pjk->jk", share, b, b, poses.K)
    twist = np.concatenate([np.swapaxes(poses.F, 1, 2) @ image_twist, np.swapaxes(poses.JG * b[..., None], 1, 2)], axis=2)
    own_joint = poses.K @ (Jt @ poses.own_twist)
    by_image = poses.own.product(share[:, None, None] * image) - flat_product(poses.N @ poses.own_twist, share[:, None, None] * image_twist)
    own = [by_image, np.einsum("p,pj,pje->ej", share, b, own_joint)]
    twist, own = (np.concatenate([x[..., :3], x[..., 4:], x[..., 3:4]], axis=-1) for x in (twist, np.concatenate(own, axis=1)))
    twist *= share[:, None, None]
    by_station, by_parameter = variance.projections(twist, own)
    return score, 2 * (square - by_parameter.T @ by_parameter - by_station.T @ by_station)


class _PoseVariance:
    """Covariance of what was estimated: of the twist y of each pose and of the own parameters, where the whitened columns are G y and the
    own columns."""

    def __init__(self, system: PoseSystem):
        self.poses, self.normal = system.poses, system.normal
        poses, columns, run = system.poses, system.poses.columns, system.poses.rows.run
        self.f = system.normal.size - columns.own.size
        self.moved, self.station = columns.twists, columns.station
        self.root = _inverse_root(self.normal)
        y = self.station @ self.normal.station_root[run]
        x = -y @ self.normal.reduced[run]
        x[..., : self.f] += self.moved
        x, y = poses.F @ x, poses.F @ y
        x[..., self.f :] -= poses.N @ poses.own_twist
        x = (x.reshape(-1, x.shape[2]) @ self.root.T).reshape(x.shape)
        own = self.root[:, self.f :]
        self.twist = x @ np.swapaxes(x, 1, 2) + y @ np.swapaxes(y, 1, 2)
        self.mixed, self.own = x @ own, own.T @ own

    def of_rows(self) -> np.ndarray:
        """(P, B R): variance of the rows."""
        G = self.poses.G
        return np.einsum("pmu,pmu->pm", G @ self.twist, G) + self.poses.own.variance(G, self.mixed, self.own)

    def of_joints(self) -> np.ndarray:
        """(P, n): variance of the joints' columns times the rows."""
        T = np.swapaxes(self.poses.joints, 1, 2)
        by_twist, by_own = T @ self.poses.L, T @ self.poses.own_twist
        against = 2 * (by_twist @ self.mixed) + by_own @ self.own
        return np.einsum("pmu,pmu->pm", by_twist @ self.twist, by_twist) + np.einsum("pme,pme->pm", against, by_own)

    def projections(self, twist: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Products of k images with what was estimated, of unit variance: (6 S', k) and (g, k). twist: (P, u, k) and own: (e, k) are
        their products with the columns."""
        k = twist.shape[2]
        y = np.swapaxes(self.normal.station_root, 1, 2) @ self.poses.rows.by_station(np.swapaxes(self.station, 1, 2) @ twist)
        A = np.concatenate([flat_product(self.moved, twist), own])
        flat = y.reshape(-1, k)
        return flat, self.root @ (A - self.normal.reduced.reshape(-1, len(A)).T @ flat)


def _inverse_root(normal: Normal) -> np.ndarray:
    """R (g, g) with R'R the covariance of the parameters."""
    return np.linalg.inv(np.linalg.cholesky(_regular(normal.information)))


def _regular(information: np.ndarray) -> np.ndarray:
    return information + np.diag(1e-14 * np.diag(information).max(initial=1.0) * np.ones(len(information)))
