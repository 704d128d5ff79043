"""Noise before any fit: stated figures or guesses, their broad log-normal priors, and covariances that single measurements state."""

from __future__ import annotations

import numpy as np

from mbcacq.estimation.options import Noise
from mbcacq.estimation.variance_components import LEAST_POINT, NoisePrior, pack
from mbcacq.model.cell import Cell
from mbcacq.model.joint_resolution import rounding_noise
from mbcacq.model.observations import Observations

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
    return Noise(point, np.hypot(joint, rounding_noise(cell.joint_step)) if cell.joint_step else joint, cell.noise_rad or 1e-4)


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
