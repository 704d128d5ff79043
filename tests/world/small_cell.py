"""A small cell for the tests: a KR 10, two stations with eight balls, one with a bar."""

from types import SimpleNamespace

import numpy as np
from mbcacq_fakes.world.arm import Masses
from mbcacq_fakes.world.description import ArtefactFacts, CellFacts
from mbcacq_fakes.world.world import Deviations

# Eight balls of 12 mm, irregular, about 60 mm across.
BALLS = np.array(
    [
        [-31.8, 7.2, 0.5],
        [10.3, 23.8, 4.4],
        [6.0, -12.8, 1.2],
        [-10.0, -27.9, -2.8],
        [24.9, -2.6, -7.0],
        [31.2, 15.6, -10.1],
        [-8.7, 6.3, 7.4],
        [-21.9, -9.6, 6.4],
    ]
)
SIGN = np.array([-1.0, 1, 1, -1, 1, -1])
ROWS = np.array(
    [[0, 400, 25, -90, 0], [0, 0, 560, 0, 0], [-90, 0, 25, -90, 0], [0, 515, 0, 90, 0], [0, 0, 0, -90, 0], [180, 90, 0, 0, 0]], dtype=float
)
ROWS[:, [0, 3, 4]] = np.radians(ROWS[:, [0, 3, 4]])
HAND_EYE = np.array([[0, -1, 0, 1.2], [-1, 0, 0, -0.5], [0, 0, -1, 264.8], [0, 0, 0, 1]], dtype=float)
MASSES = Masses(
    np.array([8.4, 17.8, 6.1, 5.2, 1.6, 0.7]),
    np.array([[-18, 85, 16], [-369, -5, 15], [-12, -18, 44], [1, -178, 9], [-1, -24, 9], [0, 0, -17.0]]),
    2.5,
    np.array([10.0, -5, 70]),
    np.array([0, 0, -1.0]),
)


def pose_looking_down(q1, q5=90.0):
    return np.radians([q1, -80.0, 80.0 + 90.0 - q5, 0.0, q5, 0.0])


def facts():
    """Two stations with the eight balls in view from poses_q(), a third with a two-ball bar."""
    q = poses_q()
    artefacts = (
        ArtefactFacts("mbc", tuple(range(1, 9)), BALLS, np.full(8, 12.0), 0.001),
        ArtefactFacts("bar", (9, 10), np.array([[-30.0, 0, 0], [30.0, 0, 0]]), np.full(2, 25.0), 0.001),
    )
    plain = CellFacts(
        sign=SIGN,
        rows=ROWS,
        masses=MASSES,
        gear_ratio=np.full(6, 100.0),
        hand_eye=HAND_EYE,
        artefacts=artefacts,
        station_ids=("1", "2", "3"),
        station_artefact=np.array([0, 0, 1]),
        station_pose=np.tile(np.eye(4), (3, 1, 1)),
    )
    from mbcacq_fakes.world.world import World

    world = World(plain, Deviations(np.zeros((6, 5)), np.zeros(6), HAND_EYE, station_mm=0, station_rad=0))
    stations = world.arm.flange(q[[0, 3, 5]]) @ HAND_EYE
    return CellFacts(
        sign=SIGN,
        rows=ROWS,
        masses=MASSES,
        gear_ratio=np.full(6, 100.0),
        hand_eye=HAND_EYE,
        artefacts=artefacts,
        station_ids=("1", "2", "3"),
        station_artefact=np.array([0, 0, 1]),
        station_pose=stations,
    )


def poses_q():
    return np.array([pose_looking_down(a, b) for a, b in ((0, 90), (0, 84), (0, 97), (25, 90), (25, 82), (-30, 90))])


POSE_STATION = np.array([0, 0, 0, 1, 1, 2])


class Arm:
    """Stands in for the shared arm state: whatever the test says the arm does."""

    def __init__(self, q):
        self.reading = SimpleNamespace(time_s=0.0, q=tuple(q), qd=(0.0,) * 6, direction=(0.0,) * 6, standstill=True, arrivals=0, fault="")

    def read(self):
        return self.reading

    def go(self, q, seconds=2.0):
        old = self.reading
        self.reading = SimpleNamespace(
            **{
                **vars(old),
                "time_s": old.time_s + seconds,
                "q": tuple(q),
                "arrivals": old.arrivals + 1,
                "direction": tuple(np.sign(np.subtract(q, old.q))),
            }
        )


def fit_sphere(points, radius):
    """Plain geometric least squares with known radius: centre (3,) and residuals (N,). Points off by more than 0.1 mm are left out."""
    centre = points.mean(axis=0) - [0, 0, 0.6 * radius]
    for _ in range(30):
        away = points - centre
        distance = np.linalg.norm(away, axis=1)
        residual = distance - radius
        keep = np.abs(residual) < max(0.1, 2 * np.median(np.abs(residual)))
        step = np.linalg.lstsq(-away[keep] / distance[keep, None], residual[keep], rcond=None)[0]
        centre = centre - step
        if np.linalg.norm(step) < 1e-9:
            break
    return centre, residual
