"""Noise: what is stated or guessed before any fit, as a prior; and estimated from the data by restricted maximum likelihood (REML).

Components: scanner noise along each axis, turn of a measured orientation, repeatability of each joint. Stated figures are priors.
Average-information scoring (Gilmour, Thompson, Cullis 1995) on the logarithms; degrees of freedom spent on the geometry are
accounted for through the traces.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtrmm  # pyright: ignore[reportAttributeAccessIssue] -- compiled, without stubs

from mbcacq.estimation.normal_equations import Normal, PoseSystem, inverse_of_lower
from mbcacq.estimation.options import Noise
from mbcacq.estimation.pose_block import PoseBlock, flat_product
from mbcacq.model.cell import Cell
from mbcacq.model.joint_resolution import rounding_noise
from mbcacq.model.observations import Observations

LARGEST_STEP = 0.45  # of a scored log sigma, which may not reach 1/2; the noise grows by at most 3.2 at a time
# No instrument and no joint is better, and beyond it double precision ends: mm, rad of a joint, rad of a measured orientation. Orientations
# that are exact to 1e-7 rad (of a simulation) leave 16 digits between their information and that of places, which is then lost.
LEAST_POINT, LEAST_JOINT, LEAST_TURN = 1e-5, 1e-9, 1e-6


@dataclass(frozen=True)
class NoisePrior:
    """Normal prior of the logarithms of (point (3), joint (n), turn (1)): centre (K,), precision (K, K)."""

    centre: np.ndarray
    precision: np.ndarray

    def log_density(self, noise: Noise) -> float:
        """Log density of a noise, up to a constant."""
        off = pack(noise) - self.centre
        return -0.5 * float(off @ self.precision @ off)


def pack(noise: Noise) -> np.ndarray:
    return np.log(np.concatenate([noise.point, noise.joint, [noise.turn]]))


def unpack(theta: np.ndarray) -> Noise:
    value = np.exp(theta)
    return Noise(value[:3], value[3:-1], float(value[-1]))


def between(noise: Noise, other: Noise) -> Noise:
    """The noise halfway between two, of the logarithms."""
    return unpack((pack(noise) + pack(other)) / 2)


def restricted_maximum_likelihood(
    system: Callable[[Noise], PoseSystem], start: Noise, prior: NoisePrior, rounds: int = 12, tolerance: float = 0.02
) -> Noise:
    """Most probable noise of a linear problem, whose whitened system under any noise ``system`` gives."""
    noise = start
    for _ in range(rounds):
        before, (noise, _) = noise, reml_step(system(noise), noise, prior)
        if np.abs(pack(noise) - pack(before)).max() < tolerance:
            break
    return noise


def reml_step(system: PoseSystem, noise: Noise, prior: NoisePrior) -> tuple[Noise, float]:
    """One step of average-information scoring (REML); also the rise of the log posterior density that its quadratic model promises."""
    score, information = reml_score_and_information(system, noise)
    theta = pack(noise)
    score = score - prior.precision @ (theta - prior.centre)
    step = np.linalg.solve(information + prior.precision, score)
    least = np.log(np.concatenate([np.full(3, LEAST_POINT), np.full(len(noise.joint), LEAST_JOINT), [LEAST_TURN]]))
    return unpack(np.maximum(theta + step_of_log_sigma(step), least)), 0.5 * float(step @ score)


def step_of_log_sigma(scored: np.ndarray) -> np.ndarray:
    """The step of log sigma to take where scoring gives this one.

    If one variance component alone is q times as large as supposed, the scored step is s = (q - 1) / 2q, and log(q) / 2 leads to the
    maximum. So -log(1 - 2 s) / 2 is taken, which is s to first order. Scored steps themselves overshoot where a noise is smaller than
    supposed, and may go to and fro about the maximum without end.
    """
    return -0.5 * np.log1p(-2 * np.minimum(scored, LARGEST_STEP))


def log_restricted_posterior(system: PoseSystem, noise: Noise, prior: NoisePrior) -> float:
    """Log of the restricted likelihood of a noise, with its prior, up to a constant; the residual is what the best fit leaves."""
    normal = system.normal
    log_det = system.poses.log_det + float(np.linalg.slogdet(_regular(normal.information))[1]) + normal.station_log_det
    return prior.log_density(noise) - 0.5 * (log_det + normal.cost)


def log_evidence(system: PoseSystem, noise: Noise, prior: NoisePrior, sigma: np.ndarray) -> float:
    """Log marginal likelihood of a model with random effects, up to a constant that is common to models with the same flat parameters.

    sigma: (g,) prior of the parameters, inf where flat.
    """
    return log_restricted_posterior(system, noise, prior) - float(np.sum(np.log(sigma[np.isfinite(sigma)])))


def reml_score_and_information(system: PoseSystem, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (K,) and average information (K, K) of the restricted log likelihood by the log sigmas.

    From the twists of the poses; only the balls and the effects have rows of their own.
    """
    poses, normal, n = system.poses, system.normal, len(noise.joint)
    R, S, k = len(poses.precision), len(normal.reduced), n + 4
    by_axis, by_joint, square = np.full(R, -poses.weighted.counted), np.zeros(n), np.zeros((k, k))
    by_parameter, by_station = np.zeros((normal.size, k)), np.zeros((S, 6, k))
    root = _inverse_root(normal)
    for block in poses.blocks:
        score = _BlockScore(block, normal, root)
        by_axis += score.by_axis
        by_joint += score.by_joint
        square += score.square
        by_parameter += score.by_parameter
        by_station[block.place.stations] += score.by_station
    # The images' products with what was estimated, of unit variance.
    flat = (np.swapaxes(normal.station_root, 1, 2) @ by_station).reshape(-1, k)
    estimated = root @ (by_parameter - normal.reduced.reshape(6 * S, normal.size).T @ flat)
    axes = np.zeros(4)
    np.add.at(axes, np.minimum(np.arange(R), 3), by_axis)
    score = np.concatenate([axes[:3], by_joint, axes[3:]])
    return score, 2 * (square - estimated.T @ estimated - flat.T @ flat)


class _BlockScore:
    """What the poses of a block add to the score and the average information.

    by_axis: (R,) and by_joint: (n,) of the score. The average information is Y' P Y of the images Y, one of each component; square: (k, k)
    their products under the noise, by_parameter: (g, k) and by_station: (S', 6, k) with the columns.
    """

    def __init__(self, block: PoseBlock, normal: Normal, root: np.ndarray):
        share, precision, white = block.share, block.precision, block.white_residual
        P, R, _ = white.shape
        n = block.K.shape[1]
        variance = _BlockVariance(block, normal, root)
        # Scanner: the rows of one axis each.
        weighted = white * share[:, None, None]
        squares = np.einsum("prb,prb->r", weighted, white)
        absorbed = (block.weighted.squares @ (block.N * share[:, None, None]).reshape(P, -1, 1)).sum(axis=0)[:, 0]
        self.by_axis = squares + precision * (absorbed + variance.of_axes())
        # Joints: one column a pose.
        b = share[:, None] * block.residual_joint
        diagonal = 1 - np.diagonal(block.K, axis1=1, axis2=2)
        self.by_joint = np.sum(b**2 - share[:, None] * diagonal, axis=0) + variance.of_joints()
        fold = np.minimum(np.arange(R), 3)[:, None] == np.arange(4)  # (R, 4): scanner's axes and turn
        image = weighted * np.sqrt(precision)[:, None]
        image_twist = np.swapaxes((image[:, :, None] @ block.weighted.G)[:, :, 0], 1, 2) @ fold
        Jt = np.swapaxes(block.joints, 1, 2)
        image_joint = Jt @ image_twist
        K_image = block.K @ image_joint
        self.square = np.zeros((n + 4, n + 4))
        order = np.r_[:3, n + 3]
        self.square[np.ix_(order, order)] = np.diag(squares @ fold) - flat_product(image_joint, K_image)
        mixed = np.einsum("pj,pjc->jc", b, K_image)
        self.square[3 : n + 3, order], self.square[order, 3 : n + 3] = mixed, mixed.T
        self.square[3 : n + 3, 3 : n + 3] = np.diag(np.sum(b**2, axis=0)) - np.einsum("pj,pk,pjk->jk", b, b, block.K)
        twist = np.concatenate([np.swapaxes(block.F, 1, 2) @ image_twist, np.swapaxes(block.JG * b[..., None], 1, 2)], axis=2)
        by_image = block.own.product(image) @ fold - flat_product(block.own_twist, block.N @ image_twist)
        own = [by_image, flat_product(block.own_twist, np.swapaxes(block.K @ Jt * b[..., None], 1, 2))]
        twist, own = (np.concatenate([x[..., :3], x[..., 4:], x[..., 3:4]], axis=-1) for x in (twist, np.concatenate(own, axis=1)))
        self.by_parameter = np.concatenate([flat_product(block.columns.twists, twist), own])
        self.by_station = block.place.products(block.columns.station, twist)


class _BlockVariance:
    """Covariance of what was estimated: of the twist y of each pose of a block and of the own parameters, where the whitened columns are
    G y and the own columns. root: (g, g) lower triangular, root' root the covariance of the parameters."""

    def __init__(self, block: PoseBlock, normal: Normal, root: np.ndarray):
        self.block, columns = block, block.columns
        f = normal.size - columns.own.size
        stations, runs = block.place.stations, block.place
        y = runs.times(columns.station, normal.station_root[stations])
        x = runs.times(y, -normal.reduced[stations])
        x[..., :f] += columns.twists
        x, y = block.F @ x, block.F @ y
        if columns.own.size:
            x[..., f:] -= block.N @ block.own_twist
        x = times_upper(x, root)
        self.twist = x @ np.swapaxes(x, 1, 2) + y @ np.swapaxes(y, 1, 2)
        own = root[f:, f:]  # the rows above have none of the own parameters
        self.mixed, self.own = x[..., f:] @ own, own.T @ own

    def of_axes(self) -> np.ndarray:
        """(R,): sum of the variances of the rows of each axis, in units of the axis' variance."""
        squares, share = self.block.weighted.squares, self.block.share[:, None, None]
        levers = (squares @ (self.twist * share).reshape(len(squares), -1, 1)).sum(axis=0)[:, 0]
        return levers + self.block.own.variance(self.mixed, self.own)

    def of_joints(self) -> np.ndarray:
        """(n,): sums of the variances of the joints' columns times the rows."""
        block = self.block
        total = block.L @ self.twist @ block.L
        if block.own.columns.size:
            against = 2 * (block.L @ self.mixed) + (block.own_twist.reshape(-1, len(self.own)) @ self.own).reshape(self.mixed.shape)
            total += against @ np.swapaxes(block.own_twist, 1, 2)
        T = block.joints
        return np.einsum("puj,puj->j", T * block.share[:, None, None], total @ T)


def times_upper(x: np.ndarray, root: np.ndarray) -> np.ndarray:
    """x (P, u, g) times the transpose of a lower triangular matrix (g, g): half of the work of a product with a full one."""
    if not len(root):
        return x
    flat = np.ascontiguousarray(x).reshape(-1, len(root))
    return dtrmm(1.0, root.T, flat.T, trans_a=1, overwrite_b=1).T.reshape(x.shape)


def _inverse_root(normal: Normal) -> np.ndarray:
    """R (g, g) with R'R the covariance of the parameters."""
    return inverse_of_lower(np.linalg.cholesky(_regular(normal.information)))


def _regular(information: np.ndarray) -> np.ndarray:
    return information + np.diag(1e-14 * np.diag(information).max(initial=1.0) * np.ones(len(information)))


# Standard deviations of logarithms.
STATED = 0.7  # a stated instrument noise is right within a factor of two
GUESSED = 1.5  # of an instrument of which nothing is stated only the order of magnitude is known
AXIS = 0.25  # deviation of an axis of the instrument from the level that all axes share
COMMON = 1.0  # the level that all joints of an arm share
JOINT = 0.15  # deviation of a joint from that level
EXACT = 1e-3  # a figure that is taken as it is


def first_noise(cell: Cell) -> Noise:
    """Stated figures, or guesses: 0.02 mm a centre, and the repeatability of the data sheet turned into angles at the arm's reach, with
    what the joints were rounded by."""
    point = np.full(3, 0.02) if cell.noise_mm is None else np.maximum(cell.noise_mm, LEAST_POINT)
    joint = cell.robot.chain.expected_noise(cell.robot.repeatability_mm or 0.06)
    rounded = cell.robot.chain.by_kind(rounding_noise(cell.joint_step), 0.0)
    return Noise(point, np.hypot(joint, rounded) if cell.joint_step else joint, cell.noise_rad or 1e-4)


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
    lever = cell.robot.chain.lever
    alike = lever[:, None] == lever  # joints of one kind; of poses of the flange, displacements and rotations
    precision[3:-1, 3:-1] = np.linalg.inv(single**2 * np.eye(n) + common**2 * alike)
    precision[-1, -1] = 1 / (STATED if cell.noise_rad and option != "estimate" else GUESSED) ** 2
    return NoisePrior(pack(noise), precision)


def stated_weights(obs: Observations, noise: Noise) -> np.ndarray | None:
    """(M, R, R) that give rows with the stated covariances the noise of the instrument as a whole; None where none are stated.

    The inverse square root of each correlation matrix, so that every row stays as near to its own axis as it can.
    """
    if obs.covariance is None:
        return None
    sigma = np.sqrt(np.einsum("mii->mi", obs.covariance))
    value, vector = np.linalg.eigh(obs.covariance / sigma[:, :, None] / sigma[:, None, :])
    root = (vector / np.sqrt(value)[:, None]) @ np.swapaxes(vector, 1, 2)
    return noise.row_sigma(sigma.shape[1])[:, None] * root / sigma[:, None, :]
