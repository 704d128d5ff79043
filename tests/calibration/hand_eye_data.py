"""Simulated hand-eye recordings: poses of a flange, and what a scanner saw of a target, with the truth and the noise that was put in."""

from dataclasses import dataclass

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.flange_poses import flange_coordinates
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, TARGET_IN_BASE, Artefact, Cell, Station, arm_of_flange_poses
from mbcacq.model.observations import Observations

BALLS = np.array([[-30.0, 0, 0], [30, 5, 4], [0, 40, -6], [10, -25, 20], [-15, -30, 2]])
POSE_SIGMA = np.array([0.02, 0.02, 0.02, 1e-4, 1e-4, 1e-4])  # of the flange, mm and rad
POINT_SIGMA = np.array([0.02, 0.02, 0.05])
TARGET_SIGMA = np.array([0.03, 0.03, 0.15, 1e-3, 1e-3, 2e-4])


@dataclass(frozen=True)
class Recording:
    observations: Observations
    T_flange_scanner: np.ndarray
    T_base_station: np.ndarray


def frame(rng, size, centre, turn):
    return se3.transform(se3.rotation_exp(turn * rng.normal(size=3)), np.array(centre) + size * rng.normal(size=3))


def recording(rng, kind, *, poses=24, measurement=ARTEFACT_IN_SCANNER, noise=1.0) -> Recording:
    """kind: 'target' (its pose, with covariance), 'sphere', 'certified' or 'uncertified' (balls)."""
    X = frame(rng, 20.0, [30.0, -10, 120], 0.3)
    Z = frame(rng, 50.0, [650.0, 0, 100], 0.3)
    turned = se3.rotation_exp(np.array([np.pi, 0, 0])) @ se3.rotation_exp(0.4 * rng.normal(size=(poses, 3)))
    true = se3.transform(turned, np.array([600.0, 0, 450]) + 80 * rng.normal(size=(poses, 3)))
    seen = se3.inverse(true @ X) @ Z if measurement == ARTEFACT_IN_SCANNER else se3.inverse(Z) @ true @ X
    off = noise * POSE_SIGMA * rng.normal(size=(poses, 6))
    reported = se3.transform(se3.rotation_exp(off[:, 3:]) @ true[:, :3, :3], true[:, :3, 3] + off[:, :3])
    q = flange_coordinates(reported)
    centres = {"target": np.zeros((1, 3)), "sphere": np.zeros((1, 3))}.get(kind, BALLS)
    ids = tuple(range(1, len(centres) + 1))
    guess = np.full_like(centres, np.nan) if kind == "uncertified" else centres
    artefact = Artefact("a", "", ids, guess, np.zeros(len(ids)), 0.0, certified=kind != "uncertified")
    robot = arm_of_flange_poses("arm", 0.02, q)
    near = X @ se3.exp(np.r_[5.0, -5, 5, 0.05, 0, 0.05])
    pose = np.repeat(np.arange(poses), len(ids))
    ball = np.tile(np.arange(len(ids)), poses)
    xyz = se3.apply(seen[pose], centres[ball])
    extra = {}
    sigma = POINT_SIGMA
    if kind == "target":
        sigma = TARGET_SIGMA
        drawn = noise * sigma * rng.normal(size=(poses, 6))
        xyz = xyz + drawn[:, :3]
        extra = {"rotation": se3.rotation_exp(drawn[:, 3:]) @ seen[:, :3, :3], "covariance": np.tile(np.diag(sigma**2), (poses, 1, 1))}
    else:
        xyz = xyz + noise * sigma * rng.normal(size=xyz.shape)
    cell = Cell(robot, near, (artefact,), (Station("s", "a"),), noise_mm=sigma[:3], measurement=measurement)
    obs = Observations(cell, np.arange(1, poses + 1), np.zeros(poses, int), q, pose, ball, xyz, **extra)
    return Recording(obs, X, Z)


def local_error(found, true):
    """(6,) twist behind the true frame that leads to the one found: mm and rad."""
    off = se3.inverse(true) @ found
    return np.concatenate([off[:3, 3], se3.rotation_log(off[:3, :3])])


__all__ = ["ARTEFACT_IN_SCANNER", "BALLS", "TARGET_IN_BASE", "Recording", "local_error", "recording"]
