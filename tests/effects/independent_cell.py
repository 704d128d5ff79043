"""A cell in plain numpy, written without anything of the tool: kinematics, gravity, and each physical error where it happens.

Units are mm, rad, s, kg, N and N m. Every function says what the physics is; the tests compare the effects of the catalogue with it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import numpy as np

G = 9.80665  # N/kg
SIGN = np.array([-1.0, 1, 1, -1, 1, -1])
THETA = np.radians([0.0, 0, -90, 0, 0, 180])
D = np.array([450.0, 0, 0, 660, 0, 80])
A = np.array([150.0, 610, 20, 0, 0, 0])
ALPHA = np.radians([-90.0, 0, -90, 90, -90, 180])
MASS = np.array([0.0, 38, 24, 9, 5, 0.5])
COM = np.array([[0.0, 0, 0], [-240, 15, 0], [0, 10, 120], [0, 200, -8], [4, 0, 0], [0, 0, -20]])  # in the frame behind each link
PAYLOAD, PAYLOAD_COM = 3.0, np.array([-15.0, 30.0, 110.0])
DOWN = np.array([0.28, 0.0, -0.96])  # the arm hangs askew, so that no axis is vertical
BALLS = np.array([[-30.0, 8, 1], [10, 24, 4], [6, -13, 2], [-10, -28, -3], [25, -3, -7], [31, 16, -10], [-9, 6, 7], [-23, -10, 6]])
BALLS = BALLS - BALLS.mean(axis=0)
T_FLANGE_SCANNER = np.array([[0.0, -1, 0, 12], [-1, 0, 0, -5], [0, 0, -1, 264], [0, 0, 0, 1]])


def rotation(vector: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: the rotation (3, 3) by |vector| rad about it."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def pose(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def frames(q: np.ndarray, growth: dict[int, float] | None = None) -> list[np.ndarray]:
    """The base and the frame behind each link for angles q (6,); growth: index of a link -> mm by which it is longer along itself."""
    T, out = np.eye(4), [np.eye(4)]
    for i in range(6):
        factor = 1 + (growth or {}).get(i, 0.0) / max(np.hypot(A[i], D[i]), 1e-9)
        about_z = pose(rotation(np.array([0, 0, SIGN[i] * q[i] + THETA[i]])), np.zeros(3))
        along = pose(np.eye(3), np.array([factor * A[i], 0, factor * D[i]]))
        T = T @ about_z @ along @ pose(rotation(np.array([ALPHA[i], 0, 0])), np.zeros(3))
        out.append(T)
    return out


def masses(q: np.ndarray, payload: float = PAYLOAD, com: np.ndarray = PAYLOAD_COM) -> list[tuple[float, np.ndarray]]:
    """Each mass of the arm (kg) with its centre in the base frame (mm)."""
    at = frames(q)
    links = [(m, (T @ [*c, 1])[:3]) for m, c, T in zip(MASS, COM, at[1:], strict=True)]
    return [*links, (payload, (at[-1] @ [*com, 1])[:3])]


def gravity_torque(q: np.ndarray, payload: float = PAYLOAD, com: np.ndarray = PAYLOAD_COM) -> np.ndarray:
    """(6,) N m: minus the derivative of the potential energy by each angle, so positive where gravity helps the angle to grow."""
    return _gravity_torque(tuple(q.tolist()), payload, tuple(com.tolist())).copy()


@cache
def _gravity_torque(angles: tuple[float, ...], payload: float, centre: tuple[float, ...]) -> np.ndarray:
    """The same, once for each posture: fifty tests ask for it at the same ones."""
    q, com, step = np.array(angles), np.array(centre), 1e-5

    def energy(angles: np.ndarray) -> float:
        return -sum(m * G * DOWN @ r * 1e-3 for m, r in masses(angles, payload, com))

    return np.array([-(energy(q + step * e) - energy(q - step * e)) / (2 * step) for e in np.eye(6)])


def overturning_moment(q: np.ndarray) -> np.ndarray:
    """(3,) N m about the origin of the base, in base axes."""
    return np.sum([np.cross(r, m * G * DOWN) * 1e-3 for m, r in masses(q)], axis=0)


def tool_weight(q: np.ndarray) -> np.ndarray:
    """(3,) N in flange axes."""
    return frames(q)[-1][:3, :3].T @ (PAYLOAD * G * DOWN)


@dataclass
class Errors:
    """What is wrong in the cell, at each pose; the default is a perfect one.

    joint (P, 6): rad beyond the reported angles. base (P, 3): rotation vector of the whole arm about the base's origin. growth: link ->
    (P,) mm. mount: (P, 4, 4) between flange and scanner. balls (8, 3): true minus certified. station (P, 3): shift in base axes.
    reading: true points (M, 3) and their poses (M,) -> what the scanner says.
    """

    joint: np.ndarray | None = None
    base: np.ndarray | None = None
    growth: dict[int, np.ndarray] = field(default_factory=dict)
    mount: np.ndarray | None = None
    balls: np.ndarray | None = None
    station: np.ndarray | None = None
    reading: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None


@dataclass
class World:
    """q (P, 6): reported angles. order (P,): ranks in time, not as listed. station (P,): 0 or 1."""

    q: np.ndarray
    time: np.ndarray
    order: np.ndarray
    station: np.ndarray
    stations: np.ndarray
    direction: np.ndarray
    velocity: np.ndarray
    temperature: np.ndarray

    @classmethod
    def drawn(cls, count: int = 36) -> "World":
        rng = np.random.default_rng(3)
        q = np.radians([0, -75, 95, 0, 60, 0]) + rng.uniform(-1, 1, (count, 6)) * np.radians([60, 30, 30, 150, 50, 150])
        order = rng.permutation(count)
        stations = np.array([frames(one)[-1] @ T_FLANGE_SCANNER for one in q[:2]])
        return cls(
            q,
            17.0 * order + 150.0 * (order // 9),
            order,
            (order >= count // 2).astype(int),
            stations,
            rng.choice([-1, 1], (count, 6)),
            rng.normal(0, 0.1, (count, 6)),
            24 + 6 * (1 - np.exp(-order / 15)),
        )

    @property
    def pose_of_centre(self) -> np.ndarray:
        return np.repeat(np.arange(len(self.q)), len(BALLS))

    def measure(self, wrong: Errors | None = None) -> np.ndarray:
        """(M, 3) mm: the centres of all balls in the scanner frame, pose after pose."""
        wrong, out = wrong or Errors(), []
        for p, q in enumerate(self.q):
            true_q = q if wrong.joint is None else q + wrong.joint[p]
            arm = frames(true_q, {i: mm[p] for i, mm in wrong.growth.items()})[-1]
            if wrong.base is not None:
                arm = pose(rotation(wrong.base[p]), np.zeros(3)) @ arm
            scanner = arm @ (np.eye(4) if wrong.mount is None else wrong.mount[p]) @ T_FLANGE_SCANNER
            artefact = self.stations[self.station[p]]
            points = (BALLS + (0 if wrong.balls is None else wrong.balls)) @ artefact[:3, :3].T + artefact[:3, 3]
            if wrong.station is not None:
                points = points + wrong.station[p]
            out.append((points - scanner[:3, 3]) @ scanner[:3, :3])
        true = np.concatenate(out)
        return true if wrong.reading is None else wrong.reading(true, self.pose_of_centre)
