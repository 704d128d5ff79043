"""What effects are functions of: gravity torque, order and time of the poses, temperatures, positions in the field of view."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.effects.effect import Missing
from mbcacq.estimation.forward_model import CellState, Prediction
from mbcacq.geometry import gravity
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class Context:
    """Observations with the geometry that was fitted to them, and the prediction by that geometry."""

    obs: Observations
    state: CellState
    prediction: Prediction

    @property
    def n(self) -> int:
        """The number of joints."""
        return self.obs.cell.robot.n

    @property
    def scanner_on_flange(self) -> bool:
        """False for an external instrument that measures a target on the flange."""
        return self.obs.cell.measurement != TARGET_IN_BASE

    @cached_property
    def masses_known(self) -> bool:
        """Whether any mass of the links or of the payload is given."""
        robot = self.obs.cell.robot
        return bool(np.any(robot.mass > 0) or robot.payload_mass > 0)

    @cached_property
    def payload_mass(self) -> np.ndarray:
        """(P,) kg: as recorded with each pose, or as declared for the robot."""
        if self.obs.payload_kg is not None:
            return np.asarray(self.obs.payload_kg, dtype=float)
        return np.full(self.obs.n_poses, self.obs.cell.robot.payload_mass)

    @property
    def payload_com(self) -> np.ndarray:
        """(P, 3) mm in the flange frame."""
        if self.obs.payload_com is not None:
            return self.obs.payload_com
        return np.broadcast_to(self.obs.cell.robot.payload_com, (self.obs.n_poses, 3))

    @cached_property
    def links(self) -> tuple[np.ndarray, np.ndarray]:
        """Masses (n,) and centres of mass (n, 3); where none are given, one kg halfway along each link.

        Torques of these are proportional to the true ones only roughly, and their size is not meaningful.
        """
        robot = self.obs.cell.robot
        if self.masses_known:
            return robot.mass, robot.com
        back = np.linalg.inv(robot.chain.link_transforms(np.zeros((1, robot.n)))[0])[:, :3, 3]
        return np.ones(robot.n), 0.5 * back

    @cached_property
    def gravity_torque(self) -> np.ndarray:
        """(P, n) N m about each joint, in the direction in which the controller counts its angle; of the masses in ``links``."""
        robot = self.obs.cell.robot
        mass, com = self.links
        payload = self.payload_mass if self.masses_known else 1.0
        return gravity.gravity_torque(robot.chain, robot.chain.frames(self.obs.q), mass, com, payload, self.payload_com, robot.gravity)

    def gravity_moment(self, frame: int) -> np.ndarray:
        """(P, 3) N m: moment of all weight behind ``frame`` (0 base .. n flange) about its origin, in its own axes."""
        robot = self.obs.cell.robot
        mass, com = self.links
        frames = robot.chain.frames(self.obs.q)
        weight = gravity.STANDARD_GRAVITY * robot.gravity
        load = self.payload_mass if self.masses_known else np.ones(len(frames))
        tool = np.einsum("pij,pj->pi", frames[:, -1, :3, :3], self.payload_com) + frames[:, -1, :3, 3]
        origin = frames[:, frame, :3, 3]
        moment = load[:, None] * (tool - origin)
        for i in range(frame, robot.n):
            centre = np.einsum("pij,j->pi", frames[:, i + 1, :3, :3], com[i]) + frames[:, i + 1, :3, 3]
            moment = moment + mass[i] * (centre - origin)
        return np.einsum("pji,pj->pi", frames[:, frame, :3, :3], np.cross(moment, weight)) * 1e-3

    @cached_property
    def flange_gravity(self) -> np.ndarray:
        """(P, 3) direction of gravity in flange axes."""
        return np.einsum("pji,j->pi", self.prediction.frames[:, -1, :3, :3], self.obs.cell.robot.gravity)

    @cached_property
    def order(self) -> np.ndarray:
        """(P,) rank of each pose in time (by time where recorded, else as listed)."""
        return rank_in_time(self.obs)

    @property
    def time(self) -> np.ndarray:
        """(P,) s since the first pose of the recording; raises Missing where the recording has no times."""
        if self.obs.time_s is None or np.ptp(self.obs.time_s) == 0:
            raise Missing("no times recorded")
        if self.obs.recording is None:
            return self.obs.time_s - self.obs.time_s.min()
        first = np.full(self.obs.n_recordings, np.inf)
        np.minimum.at(first, self.obs.recording, self.obs.time_s)
        return self.obs.time_s - first[self.obs.recording]


def rank_in_time(obs: Observations) -> np.ndarray:
    """(P,) rank of each pose in time (by time where recorded, else as listed)."""
    key = obs.time_s if obs.time_s is not None else np.arange(obs.n_poses)
    return np.argsort(np.argsort(key, kind="stable"), kind="stable")
