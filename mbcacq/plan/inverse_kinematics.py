"""Inverse kinematics of an arm: in closed form where it has a spherical wrist or three parallel axes, else numerically.

Spherical wrist: MD-H rows -> ortho-parallel parameters -> all branches at once. Parameters and branches after Brandstoetter, Angerer,
Hofbaur: "An Analytical Solution of the Inverse Kinematics Problem of Industrial Serial Manipulators with an Ortho-parallel Basis and a
Spherical Wrist" (2014), as py-opw-kinematics implements them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.numerical_inverse import SAMPLED, NumericalInverse, SolverOptions
from mbcacq.geometry.three_parallel_axes import ThreeParallelAxesInverse
from mbcacq.model.cell import RobotModel

if TYPE_CHECKING:
    from py_opw_kinematics import Robot

FULL_TURN = 2 * np.pi
AGREEMENT = 1e-6  # mm, and rad: how well the closed form must repeat the chain


class InverseKinematics(Protocol):
    """Solver of one arm."""

    def solutions(self, T_base_flange: np.ndarray, margin: float = 0.0) -> list[np.ndarray]:
        """All joint positions within the limits less ``margin`` (rad), full turns included: per pose (P, 4, 4) (k, n) rad, k may be 0.

        An arm with more than six axes has a continuum, of which these are samples.
        """
        ...

    def nearest(self, T_base_flange: np.ndarray, q: np.ndarray) -> np.ndarray | None:
        """A joint position (n,) rad at a pose (4, 4) on the branch of ``q`` (n,), or None."""
        ...


def inverse_kinematics(
    robot: RobotModel, home: np.ndarray | None = None, *, sampled: bool = False, free: Sequence[bool] = ()
) -> InverseKinematics:
    """The solver that suits an arm. home: (n,) rad, a posture near which solutions are wanted where there is a continuum of them. sampled:
    whether only some branches of an arm without a closed form are looked for, which takes a quarter of the time. free: of each external
    axis before the arm, whether it may leave home."""
    if robot.external and home is not None:
        return ExternalAxesInverse.of(robot, home, free or (True,) * robot.external, sampled)
    try:
        return OrthoParallelInverse.of(robot)
    except ConfigError:
        closed = ThreeParallelAxesInverse.of(robot.chain, robot.limits)
        options = SAMPLED if sampled else SolverOptions()
        return closed or NumericalInverse(robot.chain, robot.limits, options, preferred=home)


GRID = 9  # places of a free external axis that are tried: the least of a few metres of track over the reach of an arm


@dataclass(frozen=True)
class ExternalAxesInverse:
    """Solver of an arm behind external axes: that of the arm alone, at places of these axes spread over what they may do.

    chain: of all axes; arm: solver of the arm's own; places: (k, m) positions of the external axes, home first.
    """

    chain: Chain
    arm: InverseKinematics
    places: np.ndarray
    limits: np.ndarray

    @classmethod
    def of(cls, robot: RobotModel, home: np.ndarray, free: Sequence[bool], sampled: bool) -> ExternalAxesInverse:
        """The solver of a robot whose first axes are external."""
        m, chain = robot.external, robot.chain
        own = Chain(chain.sign[m:], *chain.rows[m:].T)
        arm = inverse_kinematics(replace(robot, chain=own, limits=robot.limits[m:], names=()), home[m:], sampled=sampled)
        spread = [
            np.r_[home[i], np.linspace(robot.limits[i, 0], robot.limits[i, 1], GRID)] if free[i] else home[i : i + 1] for i in range(m)
        ]
        return cls(chain, arm, np.array(list(product(*spread))), robot.limits)

    def _bases(self, places: np.ndarray) -> np.ndarray:
        """(k, 4, 4): the frame of the arm's first axis at places (k, m) of the external axes."""
        q = np.zeros((len(places), self.chain.n))
        q[:, : places.shape[1]] = places
        return self.chain.frames(q)[:, places.shape[1]]

    def solutions(self, T_base_flange: np.ndarray, margin: float = 0.0) -> list[np.ndarray]:
        """Per pose (P, 4, 4) the positions (k, n) rad, mm that reach it at any of the places."""
        targets = np.asarray(T_base_flange, dtype=float).reshape(-1, 4, 4)
        every = se3.inverse(self._bases(self.places))[None] @ targets[:, None]
        found = self.arm.solutions(every.reshape(-1, 4, 4), margin)
        k = len(self.places)
        return [
            np.concatenate(
                [np.column_stack([np.tile(e, (len(q), 1)), q]) for e, q in zip(self.places, found[p * k : (p + 1) * k], strict=True)]
            )
            for p in range(len(targets))
        ]

    def nearest(self, T_base_flange: np.ndarray, q: np.ndarray) -> np.ndarray | None:
        """The position (n,) at a pose (4, 4) with the external axes as at ``q`` (n,), on its branch; None where there is none."""
        m = self.places.shape[1]
        found = self.arm.nearest(se3.inverse(self._bases(q[None, :m])[0]) @ T_base_flange, q[m:])
        return None if found is None else np.concatenate([q[:m], found])


def wrist_axis(n: int) -> int:
    """Index of the axis whose sign tells the two ways a wrist reaches one orientation: the last but one of an arm of n axes."""
    return n - 2


class OpwLengths(NamedTuple):
    """The seven lengths (mm) of an ortho-parallel arm with a spherical wrist, named as in the publication."""

    a1: float
    a2: float
    b: float
    c1: float
    c2: float
    c3: float
    c4: float


@dataclass(frozen=True)
class OrthoParallelInverse:
    """Solver of one arm: T_base_flange = T_base_opw OPW(theta) T_opw_flange, theta = direction * q + offset the closed form's angles.

    limits: (6, 2) rad; direction: (6,) +1 or -1, of rotation; offset: (6,) rad; transforms: (4, 4).
    """

    limits: np.ndarray
    lengths: OpwLengths
    direction: np.ndarray
    offset: np.ndarray
    T_base_opw: np.ndarray
    T_opw_flange: np.ndarray

    @classmethod
    def of(cls, robot: RobotModel) -> OrthoParallelInverse:
        """The solver of an arm. Raises ConfigError when it has no spherical wrist or no parallel axes 2 and 3."""
        solver = _derive(robot)
        q = np.random.default_rng(0).uniform(robot.limits[:, 0], robot.limits[:, 1], (32, robot.n))
        if not np.allclose(solver.forward(q), robot.chain.flange(q), rtol=0, atol=AGREEMENT):
            raise ConfigError(_refusal(robot, "its closed form does not repeat its forward kinematics"))
        return solver

    @cached_property
    def _robot(self) -> Robot:
        from py_opw_kinematics import KinematicModel, Robot  # half a second: it imports scipy

        return Robot(KinematicModel(**self.lengths._asdict()), degrees=False)

    def forward(self, q: np.ndarray) -> np.ndarray:
        """T_base_flange (P, 4, 4) by the closed form, for q (P, 6) rad."""
        theta = self.direction * q + self.offset
        return self.T_base_opw @ self._robot.batch_forward(theta).as_matrix() @ self.T_opw_flange

    def branches(self, T_base_flange: np.ndarray) -> np.ndarray:
        """Every branch of every pose (P, 4, 4): q (P, 8, 6) rad in (-pi, pi], limits not applied; NaN where a branch does not exist."""
        from scipy.spatial.transform import RigidTransform

        poses = se3.inverse(self.T_base_opw) @ np.asarray(T_base_flange, dtype=float) @ se3.inverse(self.T_opw_flange)
        theta = self._robot.reach(RigidTransform.from_matrix(poses)).joints
        q = self.direction * (theta - self.offset)
        return np.pi - np.mod(np.pi - q, FULL_TURN)

    def solutions(self, T_base_flange: np.ndarray, margin: float = 0.0) -> list[np.ndarray]:
        """All joint positions within the limits less ``margin`` (rad), full turns included: per pose (k, 6) rad, k may be 0."""
        low, high = self.limits[:, 0] + margin, self.limits[:, 1] - margin
        return [self._within(q[np.isfinite(q).all(axis=1)], low, high) for q in self.branches(T_base_flange)]

    def nearest(self, T_base_flange: np.ndarray, q: np.ndarray) -> np.ndarray | None:
        """The solution (n,) rad at a pose (4, 4) that is closest to ``q`` (n,), or None."""
        found = self.solutions(np.asarray(T_base_flange)[None])[0]
        return found[np.argmin(np.abs(found - q).max(axis=1))] if len(found) else None

    def _within(self, q: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Adds full turns to the joints whose range allows them, and drops what lies outside."""
        choices = [(0.0,) if span < FULL_TURN else (-FULL_TURN, 0.0, FULL_TURN) for span in high - low]
        turns = np.array(list(product(*choices)))
        every = (q[:, None] + turns).reshape(-1, q.shape[1])
        # An angle just outside one end of a range may lie inside it one turn on.
        every = np.where(every > high, every - FULL_TURN, np.where(every < low, every + FULL_TURN, every))
        inside = np.all((every >= low) & (every <= high), axis=1)
        return np.unique(every[inside].round(12), axis=0)


def wrist_centre(chain: Chain) -> np.ndarray | None:
    """The point (3,) mm where axes 4, 5 and 6 meet at q = 0, or None if they do not meet."""
    frames = chain.frames(np.zeros((1, chain.n)))[0]
    z, point = frames[3:6, :3, 2], frames[3:6, :3, 3]
    across = np.eye(3) - z[:, :, None] * z[:, None, :]
    centre = np.linalg.lstsq(across.reshape(-1, 3), np.einsum("aij,aj->ai", across, point).ravel(), rcond=None)[0]
    miss = np.einsum("aij,aj->ai", across, centre - point)
    return centre if np.abs(miss).max() < AGREEMENT else None


def _derive(robot: RobotModel) -> OrthoParallelInverse:
    """Parameters of the closed form from the arm's axes at q = 0. Raises ConfigError where they do not fit it."""
    chain = robot.chain
    if robot.n != 6:
        raise ConfigError(_refusal(robot, f"it has {robot.n} axes, not 6"))
    frames = chain.frames(np.zeros((1, 6)))[0]
    axis, point = chain.sign[:, None] * frames[:6, :3, 2], frames[:6, :3, 3]
    wrist = wrist_centre(chain)
    if wrist is None:
        raise ConfigError(_refusal(robot, "axes 4, 5 and 6 do not meet in one point"))
    _refuse_skewed(robot, axis)

    # The closed form's base: z along axis 1, y along axis 2 at q = 0, origin on axis 1 at the height of the base.
    direction = np.ones(6)
    z = axis[0] if axis[0, 2] >= 0 else -axis[0]
    y = axis[1]
    direction[0], direction[2] = np.sign(axis[0] @ z), np.sign(axis[2] @ y)
    T_base_opw = se3.transform(np.stack([np.cross(y, z), y, z], axis=1), point[0] - z * (point[0] @ z))
    local = se3.inverse(T_base_opw)
    shoulder, elbow, centre, flange = (se3.apply(local, p) for p in (point[1], point[2], wrist, frames[6, :3, 3]))
    axis = axis @ T_base_opw[:3, :3]

    upper = elbow - shoulder
    theta2 = np.arctan2(upper[0], upper[2])
    forearm = axis[3] * (np.sign(axis[3] @ (centre - elbow)) or 1.0)
    direction[3] = np.sign(axis[3] @ forearm)
    pitch = np.arctan2(forearm[0], forearm[2])
    across = np.array([np.cos(pitch), 0.0, -np.sin(pitch)])
    theta4 = np.arctan2(-axis[4] @ across, axis[4, 1])
    bent = np.cos(theta4) * across + np.array([0.0, np.sin(theta4), 0.0])
    tool = axis[5] * (np.sign(axis[5] @ (flange - centre)) or 1.0)
    direction[5] = np.sign(axis[5] @ tool)
    theta5 = np.arctan2(tool @ bent, tool @ forearm)
    lengths = OpwLengths(
        a1=float(shoulder[0]),
        a2=float((centre - elbow) @ across),
        b=float(centre[1]),
        c1=float(shoulder[2]),
        c2=float(np.hypot(upper[0], upper[2])),
        c3=float((centre - elbow) @ forearm),
        c4=float((flange - centre) @ tool),
    )
    offset = np.array([0.0, theta2, pitch - theta2, theta4, theta5, 0.0])
    bare = OrthoParallelInverse(robot.limits, lengths, direction, offset, T_base_opw, np.eye(4))
    return replace(bare, T_opw_flange=se3.inverse(bare.forward(np.zeros((1, 6)))[0]) @ frames[6])


def _refuse_skewed(robot: RobotModel, axis: np.ndarray) -> None:
    """Raises ConfigError unless axes 2 and 3 are parallel and the other neighbours perpendicular; axis: (6, 3) unit vectors at q = 0."""
    square = {"1 and 2": axis[0] @ axis[1], "3 and 4": axis[2] @ axis[3], "4 and 5": axis[3] @ axis[4], "5 and 6": axis[4] @ axis[5]}
    for pair, cosine in square.items():
        if abs(cosine) > AGREEMENT:
            raise ConfigError(_refusal(robot, f"axes {pair} are not perpendicular"))
    if abs(axis[1] @ axis[2]) < 1 - AGREEMENT:
        raise ConfigError(_refusal(robot, "axes 2 and 3 are not parallel"))


def _refusal(robot: RobotModel, why: str) -> str:
    return f"robot '{robot.name}' has no inverse kinematics in closed form, because {why}"
