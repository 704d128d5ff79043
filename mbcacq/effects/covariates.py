"""What effects are functions of: joint angles, gravity torque, order and time of the poses, temperatures, positions in the field of view.

All of it follows from the recording and the nominal arm, not from what was fitted: so an effect that is kept in a file means the same
wherever it is evaluated.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from mbcacq.effects.effect import Missing
from mbcacq.geometry import gravity, se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.computed_once import ComputedOnce
from mbcacq.model.observations import Observations
from mbcacq.quantities import from_degrees

LEAST_WIDTH = 5.0  # mm, second singular value of centres that are not on one line
PAUSE = 3.0  # a pause is longer than so many times the usual time from pose to pose


def artefact_normals(obs: Observations, R_base_flange: np.ndarray) -> np.ndarray:
    """(P, 3) unit vectors in the scanner's axes.

    R_base_flange: (P, 3, 3) of the nominal arm. A pose that sees three balls not on one line shows the normal by itself. For others it is
    the mean normal of the station in the base; at a station without such poses, which holds a bar or a single ball, the mean direction
    towards the scanner.
    """
    R_base_scanner = R_base_flange @ obs.cell.T_flange_scanner.reshape(-1, 4, 4)[0, :3, :3]
    towards = R_base_scanner[:, :, 2] * _side(obs)
    own = np.array([_measured_normal(obs, p) for p in range(obs.n_poses)])
    seen = np.isfinite(own[:, 0])
    in_base = np.where(seen[:, None], np.einsum("pij,pj->pi", R_base_scanner, np.nan_to_num(own)), towards)
    out = own.copy()
    for station in np.unique(obs.station):
        here = obs.station == station
        known = here & seen if np.any(here & seen) else here
        normal = in_base[known].mean(axis=0)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
        missing = here & ~seen
        out[missing] = np.einsum("pji,j->pi", R_base_scanner[missing], normal)
    return out


def _side(obs: Observations) -> float:
    """1 where the scanner's z points back at the scanner, -1 where it points at the artefacts: from the first guess of where it sits."""
    T = obs.cell.T_flange_scanner.reshape(-1, 4, 4)[0]
    return 1.0 if T[:3, 3] @ T[:3, 2] < 0 else -1.0


def _measured_normal(obs: Observations, pose: int) -> np.ndarray:
    """(3,) of one pose; NaN where its centres do not determine it."""
    rows = np.flatnonzero(obs.pose == pose)
    if len(rows) < 3:
        return np.full(3, np.nan)
    certified = obs.cell.ball_centres[obs.ball[rows]]
    if np.linalg.svd(certified - certified.mean(axis=0), compute_uv=False)[1] < LEAST_WIDTH:
        return np.full(3, np.nan)
    measured = obs.xyz[rows]
    return se3.nearest_rotation((measured - measured.mean(axis=0)).T @ (certified - certified.mean(axis=0)))[:, 2]


RECORDING = "recording"  # number of the recording, of several of one arm
LEAN = ("lean_x", "lean_y", "lean_z")
TILT = "tilt"  # of the artefact against the scanner's axis, by which what depends on LEAN or AXIS is reported
AXIS = ("axis_x", "axis_y", "axis_z")  # of the artefact (its z), in the scanner's axes, where the geometry was fitted
UNSTATED = (RECORDING, *AXIS)  # no other recording has them
OF_RECORDING = ("time", "pose", "station", RECORDING)  # they have no meaning in another recording
_NAME = re.compile(r"^([a-z_]+?)_?(E?[0-9]+)?(?:_(mass|x|y|z))?$")  # kind, number of a joint or frame, component
LEAST_TRAVEL = 0.002  # rad, over less of which nothing that a motion leaves behind fades
FAR = 1e3  # rad of travel, beyond any over which something fades
_ALONG = re.compile(r"^gravity_along_(E?[0-9]+)_([0-9]+)_([0-9]+)$")


@dataclass(frozen=True)
class Covariates:
    """Everything of a recording that an effect may depend on."""

    obs: Observations

    def __getstate__(self) -> dict[str, Any]:
        """Without what is computed when first asked for: other processes compute what they need of it."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @property
    def n(self) -> int:
        """The number of joints."""
        return self.obs.cell.robot.n

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """(n,) names of the joints."""
        return self.obs.cell.robot.axes

    @cached_property
    def tags(self) -> tuple[str, ...]:
        """(n,) what stands for each joint in the name of a covariate."""
        return self.obs.cell.robot.tags

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """(n + 1,) names of the base and of the frames behind the joints."""
        return self.obs.cell.robot.frames

    @cached_property
    def frame_tags(self) -> tuple[str, ...]:
        """(n + 1,) the same of each frame: '0' is the base, others are called after the joint before them."""
        return ("0", *self.tags)

    @property
    def scanner_on_flange(self) -> bool:
        """False for an external instrument that measures a target on the flange."""
        return self.obs.cell.measurement != TARGET_IN_BASE

    def position(self, joint: int) -> str:
        """The covariate that is a joint's own position: q1 .. an angle (rad), s1 .. of a prismatic joint (mm)."""
        return f"{'s' if joint in self.obs.cell.robot.chain.sliding else 'q'}{self.tags[joint]}"

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
    def nominal_frames(self) -> np.ndarray:
        """(P, n+1, 4, 4) frames of the nominal arm."""
        return self.obs.cell.robot.chain.frames(self.obs.q)

    @cached_property
    def gravity_torque(self) -> np.ndarray:
        """(P, n) N m about each joint, in the direction in which the controller counts its angle; of the masses in ``links``."""
        robot = self.obs.cell.robot
        mass, com = self.links
        payload = self.payload_mass if self.masses_known else 1.0
        return gravity.gravity_torque(robot.chain, self.nominal_frames, mass, com, payload, self.payload_com, robot.gravity)

    def gravity_moment(self, frame: int) -> np.ndarray:
        """(P, 3) N m: moment of all weight behind ``frame`` (0 base .. n flange) about its origin, in its own axes."""
        robot = self.obs.cell.robot
        mass, com = self.links
        frames = self.nominal_frames
        weight = gravity.STANDARD_GRAVITY * gravity.downward(robot.chain, frames, robot.gravity).reshape(-1, 3)
        load = self.payload_mass if self.masses_known else np.ones(len(frames))
        tool = np.einsum("pij,pj->pi", frames[:, -1, :3, :3], self.payload_com) + frames[:, -1, :3, 3]
        origin = frames[:, frame, :3, 3]
        moment = load[:, None] * (tool - origin)
        for i in range(frame, robot.n):
            centre = np.einsum("pij,j->pi", frames[:, i + 1, :3, :3], com[i]) + frames[:, i + 1, :3, 3]
            moment = moment + mass[i] * (centre - origin)
        return np.einsum("pji,pj->pi", frames[:, frame, :3, :3], np.cross(moment, weight)) * 1e-3

    def gravity_direction(self, frame: int) -> np.ndarray:
        """(P, 3) direction of gravity in the axes of ``frame`` (0 base .. n flange)."""
        robot, R = self.obs.cell.robot, self.nominal_frames[:, frame, :3, :3]
        if robot.chain.floor:
            return np.einsum("pji,pj->pi", R, gravity.downward(robot.chain, self.nominal_frames, robot.gravity)[:, 0])
        return np.einsum("pji,j->pi", R, robot.gravity)

    @cached_property
    def flange_gravity(self) -> np.ndarray:
        """(P, 3) direction of gravity in flange axes."""
        return self.gravity_direction(self.n)

    @cached_property
    def payload_force(self) -> np.ndarray:
        """(P, 3) N: weight of the tool in flange axes; one kilogram is assumed where its mass is not given."""
        mass = self.payload_mass if np.all(self.payload_mass > 0) else np.ones(self.obs.n_poses)
        return mass[:, None] * gravity.STANDARD_GRAVITY * self.flange_gravity

    @cached_property
    def payload_torque(self) -> np.ndarray:
        """(P, n, 4) N m about each joint by a kilogram at the flange's origin, and by a kilogram millimetre along each flange axis."""
        robot = self.obs.cell.robot
        none = np.zeros(self.n)

        def torque(com: np.ndarray) -> np.ndarray:
            return gravity.gravity_torque(robot.chain, self.nominal_frames, none, np.zeros((self.n, 3)), 1.0, com, robot.gravity)

        at_origin = torque(np.zeros(3))
        return np.stack([at_origin] + [torque(e) - at_origin for e in np.eye(3)], axis=2)

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

    @cached_property
    def pause(self) -> np.ndarray:
        """(P,) s that passed since the pose measured before. Before the first pose the arm stood as long as ever after.
        Raises Missing where the recording has no times.
        """
        listed = np.argsort(self.order, kind="stable")
        gaps = np.diff(self.time[listed], prepend=np.nan)
        gaps[gaps < 0] = np.nan  # the first pose of another recording
        out = np.empty(len(gaps))
        out[listed] = np.where(np.isnan(gaps), np.nanmax(gaps), gaps)
        return out

    @cached_property
    def since_pause(self) -> np.ndarray:
        """(P,) s since the last pause, which is longer than ``PAUSE`` times the usual time from pose to pose. Raises Missing where the
        recording has no times."""
        listed = np.argsort(self.order, kind="stable")
        first = self.pause[listed] > PAUSE * np.median(self.pause)
        first[0] = True
        begun = np.maximum.accumulate(np.where(first, np.arange(len(first)), 0))
        out, time = np.empty(len(first)), self.time[listed]
        out[listed] = time - time[begun]
        return out

    @cached_property
    def visit(self) -> np.ndarray:
        """(P,) number of each pose within a visit to its station, from 0 for the first."""
        listed = np.argsort(self.order, kind="stable")
        station = self.obs.station[listed]
        first = np.r_[True, np.diff(station) != 0]
        begun = np.maximum.accumulate(np.where(first, np.arange(len(station)), 0))
        out = np.empty(len(station))
        out[listed] = np.arange(len(station)) - begun
        return out

    @cached_property
    def lean(self) -> np.ndarray:
        """(P, 3) unit normal of the artefact that each pose looks at, in the scanner's axes."""
        return artefact_normals(self.obs, self.nominal_frames[:, -1, :3, :3])

    @cached_property
    def incidence(self) -> np.ndarray:
        """(M, 3) direction from an instrument beside the arm to the target, in the target's axes; both as measured. Raises Missing where
        no orientation of the target is measured.
        """
        if self.scanner_on_flange or self.obs.rotation is None:
            raise Missing("no orientation of a target measured")
        return np.einsum("mji,mj->mi", self.obs.rotation, self.sight)

    @cached_property
    def sight(self) -> np.ndarray:
        """(M, 3) direction from the instrument to each measured point, in the instrument's axes."""
        return self.obs.xyz / np.maximum(np.linalg.norm(self.obs.xyz, axis=1, keepdims=True), 1e-9)

    @cached_property
    def last_motions(self) -> tuple[np.ndarray, np.ndarray]:
        """(P, n) rad of each joint's last motion before the pose, and (P, n) its direction of rotation; the first pose came from far away.

        Lost motion fades with it where grease, wind-up or a pre-sliding regime let it. Raises Missing where no directions are recorded.
        """
        if self.obs.direction is None:
            raise Missing("no direction recorded")
        listed = np.argsort(self.order, kind="stable")
        q, direction = self.obs.q[listed], self.obs.direction[listed].astype(float)
        travel = np.full(q.shape, FAR)
        travel[1:] = np.abs(np.diff(q, axis=0))
        last = np.maximum.accumulate(np.where(travel > LEAST_TRAVEL, np.arange(len(q))[:, None], 0), axis=0)
        out = np.empty(q.shape), np.empty(q.shape)
        out[0][listed], out[1][listed] = np.take_along_axis(travel, last, axis=0), np.take_along_axis(direction, last, axis=0)
        return out

    def value(self, name: str) -> np.ndarray:
        """A covariate by its name: (P,), or (M,) of those in OF_CENTRES. Raises Missing where the recording lacks it."""
        return self.computed_once(("value", name), lambda: self._value(name))

    @cached_property
    def computed_once(self) -> ComputedOnce:
        """A cache of functions of the recording: a hundred groups may need the same covariate."""
        return ComputedOnce()

    def _value(self, name: str) -> np.ndarray:
        match = _NAME.match(name)
        kind, number, component = match.groups() if match else ("", None, None)
        i, c = self.frame_tags.index(number) if number in self.frame_tags else 0, "xyz".find(component or "-")
        found: np.ndarray | None = None
        if name in self.obs.temperatures:
            found = np.asarray(self.obs.temperatures[name], dtype=float)
        elif name in ("x", "y", "z"):
            found = self.obs.xyz[:, "xyz".index(name)]
        elif number is None and component is None:
            found = self._of_pose(kind)
        elif number is None:
            found = self._of_axis(kind, c)
        elif component is None and i:
            values = self._of_joints(kind)
            found = None if values is None else np.nan_to_num(np.asarray(values[:, i - 1], dtype=float))
        elif kind == "payload_torque" and i:
            found = self.payload_torque[:, i - 1, c + 1]
        elif kind in ("gravity_moment", "gravity_direction") and number in self.frame_tags:
            found = (self.gravity_moment if kind == "gravity_moment" else self.gravity_direction)(i)[:, c]
        if (match := _ALONG.match(name)) and match[1] in self.frame_tags:
            azimuth, elevation = from_degrees([float(match[2]), float(match[3])])
            along = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
            found = self.gravity_direction(self.frame_tags.index(match[1])) @ along
        if found is None:
            raise Missing(f"no {name} recorded")
        return found

    def _of_pose(self, kind: str) -> np.ndarray | None:
        """(P,), or (M,) of the balls, of what has neither joint nor axis; None for another name."""
        obs = self.obs
        if kind == RECORDING and obs.recording is None:
            raise Missing("there is one recording only")
        known: dict[str, Callable[[], np.ndarray]] = {
            "time": lambda: self.time,
            "pose": lambda: self.order.astype(float),
            "station": lambda: obs.station.astype(float),
            "pause": lambda: self.pause,
            "since_pause": lambda: self.since_pause,
            "visit": lambda: self.visit,
            "ball": lambda: np.array(obs.cell.ball_ids, dtype=float)[obs.ball],
            "payload_kg": lambda: self.payload_mass,
            RECORDING: lambda: np.asarray(obs.recording, dtype=float),
        }
        return known[kind]() if kind in known else None

    def _of_axis(self, kind: str, c: int) -> np.ndarray | None:
        """A component of the tool's weight, or of what an instrument sees an artefact, a target or a point from; None for another name."""
        on_flange = self.scanner_on_flange
        known: dict[str, Callable[[], np.ndarray]] = {"payload_force": lambda: self.payload_force, "incidence": lambda: self.incidence}
        known |= {"lean": lambda: self.lean} if on_flange else {"sight": lambda: self.sight}
        return known[kind]()[:, c] if kind in known else None

    def _of_joints(self, kind: str) -> np.ndarray | None:
        """(P, n) of what is recorded or computed of the joints; None where it is not recorded, and for another name."""
        known: dict[str, Callable[[], np.ndarray | None]] = {
            "q": lambda: self.obs.q,
            "s": lambda: self.obs.q,
            "qd": lambda: self.obs.velocity,
            "tau": lambda: self.obs.torque,
            "direction": lambda: self.obs.direction,
            "movement": lambda: self.obs.movement,
            "travel": lambda: self.last_motions[0],
            "travel_direction": lambda: self.last_motions[1],
            "gravity_torque": lambda: self.gravity_torque,
        }
        return known[kind]() if kind in known else None


def rank_in_time(obs: Observations) -> np.ndarray:
    """(P,) rank of each pose in time (by time where recorded, else as listed)."""
    key = obs.time_s if obs.time_s is not None else np.arange(obs.n_poses)
    one_after_another = key if obs.recording is None else np.argsort(np.lexsort((key, obs.recording)), kind="stable")
    return np.argsort(np.argsort(one_after_another, kind="stable"), kind="stable")
