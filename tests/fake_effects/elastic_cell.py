"""A KR 10 with a scanner of 2.5 kg, one station with eight balls, and effects to act on it."""

from types import SimpleNamespace

import numpy as np
from mbcacq_fakes.effects import make
from mbcacq_fakes.world.arm import Masses, TrueArm
from mbcacq_fakes.world.description import ArtefactFacts, CellFacts
from mbcacq_fakes.world.hooks import Moments, Moved
from mbcacq_fakes.world.rigid import invert

# KUKA KR 10 R1100-2 with a scanner of 2.5 kg.
SIGN = np.array([-1.0, 1, 1, -1, 1, -1])
ROWS = np.array(
    [[0, 400, 25, -90, 0], [0, 0, 560, 0, 0], [-90, 0, 25, -90, 0], [0, 515, 0, 90, 0], [0, 0, 0, -90, 0], [180, 90, 0, 0, 0]], dtype=float
)
ROWS[:, [0, 3, 4]] = np.radians(ROWS[:, [0, 3, 4]])
MASSES = Masses(
    np.array([8.416, 17.837, 6.075, 5.162, 1.613, 0.734]),
    np.array(
        [
            [-18.59, 85.41, 16.27],
            [-368.84, -4.65, 15.49],
            [-12.49, -18.25, 43.86],
            [1.32, -178.02, 8.61],
            [-0.78, -24.04, 9.32],
            [0, 0, -16.74],
        ]
    ),
    2.5,
    np.array([10.0, -5.0, 70.0]),
    np.array([0, 0, -1.0]),
)
HAND_EYE = np.array([[0, -1, 0, 1.2], [-1, 0, 0, -0.5], [0, 0, -1, 264.8], [0, 0, 0, 1]], dtype=float)
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
MBC = ArtefactFacts("mbc", tuple(range(1, 9)), BALLS, np.full(8, 12.0), 0.0)
ARM = TrueArm.from_rows(SIGN, ROWS)


def spread_q(n, seed=0):
    """Joint angles of a working arm, (n, 6) rad."""
    rng = np.random.default_rng(seed)
    return np.radians([0, -75, 95, 0, 70, 0]) + rng.uniform(-1, 1, (n, 6)) * np.radians([60, 30, 30, 170, 25, 170])


def cell(q=None):
    """One station, placed so that the first of q looks straight at the artefact."""
    place = ARM.flange((spread_q(1) if q is None else np.atleast_2d(q))[:1]) @ HAND_EYE
    return CellFacts(
        sign=SIGN,
        rows=ROWS,
        masses=MASSES,
        gear_ratio=np.array([119.2, 126.1, 99.6, 80, 80.9, 50.4]),
        hand_eye=HAND_EYE,
        artefacts=(MBC,),
        station_ids=("1",),
        station_artefact=np.array([0]),
        station_pose=place,
        planned_q=spread_q(100) if q is None or len(np.atleast_2d(q)) < 2 else None,
        pace_s=10.0,
    )


def moments(q, direction=None, air=None, robot=None, time_s=None):
    p = len(q)
    time_s = 10.0 * np.arange(p) if time_s is None else np.asarray(time_s, dtype=float)
    return Moments(
        q=q,
        velocity=np.zeros_like(q),
        direction=np.zeros_like(q) if direction is None else direction,
        arrival=np.arange(p),
        time_s=time_s,
        air_C=np.full(p, 21.0) if air is None else air,
        robot_C=np.full(p, 25.0) if robot is None else robot,
        station=np.zeros(p, int),
        artefact=np.zeros(p, int),
    )


def act(name, at, strength=1.0, seed=1, facts=None, **options):
    """The effect after ``displace``, and what it moved."""
    effect = make(name, strength, seed, **options)
    facts = effect.alter(facts or cell(at.q))
    effect.begin(facts, ARM, np.random.default_rng(0))
    moved = Moved.nothing(len(at), 6, 8)
    effect.displace(at, moved)
    return effect, moved


def pose(q, station="1", balls=(), exposures=3):
    return SimpleNamespace(q=q, station=station, balls=balls, exposures=exposures)


def looking(n, seed=0, tilt=0.25):
    """(n, 6) joint angles that look at the station of ``cell()`` from around its middle."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    rng, out = np.random.default_rng(seed), []
    centre = cell().station_pose[0]
    for _ in range(n):
        T = centre.copy()
        T[:3, :3] = centre[:3, :3] @ Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3)).as_matrix()
        flange = T @ invert(HAND_EYE)

        def miss(q, flange=flange):
            now = ARM.flange(q[None])[0]
            return np.concatenate([(now - flange)[:3, 3] / 100, (now - flange)[:3, :3].ravel()])

        out.append(least_squares(miss, spread_q(1)[0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x)
    return np.array(out)
