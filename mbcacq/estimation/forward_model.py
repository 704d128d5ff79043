"""The forward model: where the scanner should have measured the balls, and how that changes with a small displacement anywhere.

With a scanner on the flange, ball b of station s appears at ``x = inv(T_base_scanner(q)) T_base_station c_b``.
With an external instrument, reflector b of the target on the flange appears at ``y = inv(T_base_station) T_base_target(q) c_b``; a single
reflector is the target's origin.

Every cause of a mismatch displaces the arm, the artefact or the measured point. Displacing everything behind some place of
the arm by a spatial twist xi (base frame) changes the prediction by ``G xi`` with one matrix G per measured centre,
whatever the place; so the derivative by any parameter or effect of the arm is G times that parameter's twist.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations


@dataclass(frozen=True)
class CellState:
    """A value for everything the forward model depends on.

    chain: MD-H rows with their errors included. T_flange_scanner: (4, 4), or the target's frame on the flange for an
    external instrument; of several recordings (R, 4, 4), the tool of each.
    T_base_station: (S, 4, 4). balls: (K, 3) mm, each in its artefact's frame.
    """

    chain: Chain
    T_flange_scanner: np.ndarray
    T_base_station: np.ndarray
    balls: np.ndarray


@dataclass(frozen=True)
class Displacements:
    """Displacements of the cell by effects, at the few locations where one can act; None means none there.

    joint: (P, n) rad added to the controller's angles. frame: (P, n+1, 6) local twists behind the base (0) and behind each
    link (1..n; n is the mount). point: (M, 3) mm added to the measured point in the scanner frame. ball: (M, 3) mm added to
    the ball in its artefact's frame. station: (P, 6) local twist of the artefact's placement at that pose. orientation: (M, 3) rad by
    which the measured orientation of a target is turned about the target's own axes.
    """

    joint: np.ndarray | None = None
    frame: np.ndarray | None = None
    point: np.ndarray | None = None
    ball: np.ndarray | None = None
    station: np.ndarray | None = None
    orientation: np.ndarray | None = None


@dataclass(frozen=True)
class Prediction:
    """Predicted centres and all that is needed to differentiate them.

    xyz: (M, 3) mm. frames: (P, n+1, 4, 4). T_base_scanner: (P, 4, 4). T_base_station: (P, 4, 4), the station of each pose.
    ball: (M, 3) mm in the artefact frame. pose: (M,) of each centre. measurement: as ``Cell`` has it.
    rotation: (M, 3, 3) predicted orientation of the target in the instrument's frame, or None. direction: (M, 3) from the instrument to the
    target where their distance alone is measured, which then stands in the first coordinate; or None.
    """

    xyz: np.ndarray
    frames: np.ndarray
    T_base_scanner: np.ndarray
    T_base_station: np.ndarray
    ball: np.ndarray
    pose: np.ndarray
    measurement: str
    rotation: np.ndarray | None = None
    direction: np.ndarray | None = None

    @cached_property
    def gradient(self) -> np.ndarray:
        """What ``differentiated`` returns, kept."""
        return self.differentiated()

    def differentiated(self) -> np.ndarray:
        """G (M, R, 6), change of the residual's rows by a spatial twist of the arm; R = 3, or 6 where the target's orientation is measured
        (rows 3..5: rotation vector in the instrument's frame, rad), or 1 of a distance."""
        by_target = self.measurement == TARGET_IN_BASE
        moving, observing = (self.T_base_scanner, self.T_base_station) if by_target else (self.T_base_station, self.T_base_scanner)
        point = se3.apply_each(moving, self.pose, self.ball)
        R = np.swapaxes(observing[:, :3, :3], 1, 2)
        R = (R if by_target else -R)[self.pose]
        out = np.zeros((len(point), 3 if self.rotation is None else 6, 6))
        out[:, :3, :3], out[:, :3, 3:] = R, se3.cross(point[:, None], R)
        if self.rotation is not None:
            out[:, 3:, 3:] = R
        return out if self.direction is None else self.direction[:, None] @ out

    @cached_property
    def ball_rotation(self) -> np.ndarray:
        """(P, 3, 3): derivative of a centre by a shift of its ball in the artefact's frame, or of a reflector in the target's."""
        scanner, station = self.T_base_scanner[:, :3, :3], self.T_base_station[:, :3, :3]
        here, there = (station, scanner) if self.measurement == TARGET_IN_BASE else (scanner, station)
        return np.swapaxes(here, 1, 2) @ there

    def by_twists(self, twists: np.ndarray) -> np.ndarray:
        """(M, R, k): derivative by coefficients whose spatial twists of the arm are given (P, k, 6)."""
        return self.gradient @ np.swapaxes(twists, -1, -2)[self.pose]


def hand_eye_of_poses(obs: Observations, state: CellState) -> np.ndarray:
    """T_flange_scanner (4, 4), or that of each pose (P, 4, 4) where there are several recordings."""
    T = state.T_flange_scanner
    return T if T.ndim == 2 else T[obs.recording]


def predict(obs: Observations, state: CellState, displacements: Displacements | None = None) -> Prediction:
    """Evaluate the forward model at every measured centre."""
    moved = displacements or Displacements()
    T_flange_scanner = hand_eye_of_poses(obs, state)
    frames = state.chain.frames(obs.q if moved.joint is None else obs.q + moved.joint, moved.frame)
    T_base_scanner = frames[:, -1] @ T_flange_scanner
    T_base_station = state.T_base_station[obs.station]
    if moved.station is not None:
        T_base_station = T_base_station @ se3.exp(moved.station)
    ball = state.balls[obs.ball]
    if moved.ball is not None:
        ball = ball + moved.ball
    by_target = obs.cell.measurement == TARGET_IN_BASE
    moving, observing = (T_base_scanner, T_base_station) if by_target else (T_base_station, T_base_scanner)
    to_instrument = se3.inverse(observing) @ moving
    xyz = se3.apply_each(to_instrument, obs.pose, ball)
    direction = None
    if obs.cell.length_scale:
        length = np.linalg.norm(xyz, axis=1, keepdims=True)
        direction, xyz = xyz / np.maximum(length, 1e-9), np.pad(length, ((0, 0), (0, 2)))
    if moved.point is not None:
        xyz += moved.point
    rotation = None if obs.rotation is None else to_instrument[obs.pose, :3, :3]
    if rotation is not None and moved.orientation is not None:
        rotation = rotation @ se3.rotation_exp(moved.orientation)
    return Prediction(
        xyz, frames, T_base_scanner, T_base_station, ball, obs.pose, obs.cell.measurement, rotation=rotation, direction=direction
    )


def residual(obs: Observations, prediction: Prediction) -> np.ndarray:
    """Measured minus predicted: (M, 3) mm, (M, 6) with the rotation vector (rad) where an orientation is measured, (M, 1) of distances."""
    difference = obs.xyz - prediction.xyz
    if prediction.direction is not None:
        return difference[:, :1]
    if prediction.rotation is None:
        return difference
    turn = obs.rotation @ np.swapaxes(prediction.rotation, -1, -2)
    return np.concatenate([difference, se3.rotation_log(turn)], axis=1)
