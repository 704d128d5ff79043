"""Small cells of known truth for the tests: an arm, an artefact at stations, poses that see it, noise by the hierarchical model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, TARGET_IN_BASE, Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations

MBC = np.array(
    [
        [-4.5, 24.9, -10.5],
        [-37.4, 6.3, -5.4],
        [6.9, -8.9, 5.8],
        [-17.6, -10.7, 5.9],
        [-30.5, -22.7, 10.2],
        [15.6, -37.0, 3.8],
        [6.3, 10.4, 14.8],
        [-16.1, -32.2, -5.1],
    ]
)
BAR = np.array([[-250.0, 0, 0], [250.0, 0, 0]])
HAND_EYE = se3.transform(np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]]), np.array([1.0, -0.5, 265.0]))


@dataclass(frozen=True)
class Simulated:
    observations: Observations
    truth: CellState
    errors: np.ndarray


def kr10() -> Chain:
    """A KR 10 class arm: axes 2 and 3 parallel, spherical wrist."""
    deg = np.pi / 180
    return Chain(
        sign=np.array([-1.0, 1, 1, -1, 1, -1]),
        theta=np.array([0, 0, -90, 0, 0, 180]) * deg,
        d=np.array([450.0, 0, 0, 660, 0, 80]),
        a=np.array([150.0, 610, 20, 0, 0, 0]),
        alpha=np.array([-90, 0, -90, 90, -90, 180]) * deg,
        beta=np.zeros(6),
    )


def iiwa() -> Chain:
    """A seven-axis arm without parallel neighbours."""
    return Chain(
        sign=np.ones(7),
        theta=np.zeros(7),
        d=np.array([360.0, 0, 420, 0, 400, 0, 126]),
        a=np.zeros(7),
        alpha=np.array([-90, 90, 90, -90, -90, 90, 0]) * np.pi / 180,
        beta=np.zeros(7),
    )


def robot(chain: Chain) -> RobotModel:
    n = chain.n
    return RobotModel("test arm", chain, np.tile([-3.0, 3.0], (n, 1)), np.zeros(n), np.zeros((n, 3)), repeatability_mm=0.04)


def random_errors(chain: Chain, rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    """Errors of the size of the paper's Table 1, zero where a parameter is redundant (d before a parallel axis, beta elsewhere)."""
    errors = rng.normal(size=(chain.n, 5)) * np.array([5e-4, 0.2, 0.2, 2e-4, 2e-4]) * scale
    parallel = chain.parallel_next()
    errors[parallel, 1] = 0
    errors[~parallel, 4] = 0
    errors[0, 0] = errors[0, 1] = 0
    errors[-1] = 0
    return errors


def scanner_cell(
    rng: np.random.Generator,
    *,
    chain: Chain | None = None,
    stations: int = 8,
    per_station: int = 8,
    bars: int = 0,
    tilt_deg: float = 30.0,
    noise: tuple[float, float, float] = (0.005, 0.005, 0.009),
    joint_rad: float = 8e-6,
    errors: np.ndarray | None = None,
    hand_eye_error: float = 1.0,
    stated: bool = True,
    preliminary: bool = False,
    bar_mm: float = 500.0,
) -> Simulated:
    """A scanner on the flange looks at an eight-ball artefact (and at bars, ball by ball) from tilts about each station's normal.

    preliminary: also the phases 'translation' (six moves along the base axes, as the nominal arm does them) and 'orientation' (six), at station 1.
    """
    bar_balls = BAR * bar_mm / 500.0
    chain = kr10() if chain is None else chain
    errors = random_errors(chain, rng) if errors is None else errors
    true_chain = chain.with_errors(errors)
    true_hand_eye = HAND_EYE @ se3.exp(hand_eye_error * rng.normal(size=6) * np.array([1, 1, 1, 0.005, 0.005, 0.005]))
    artefacts = [Artefact("mbc", "MBC-8", tuple(range(1, 9)), MBC, np.full(8, 12.0))]
    if bars:
        artefacts.append(Artefact("bar", "bar", (9, 10), bar_balls, np.full(2, 25.0)))
    placed, T_stations, q, station, phase, pose, ball = [], [], [], [], [], [], []
    for s in range(stations + bars):
        bar = s >= stations
        placed.append(Station(str(s + 1), "bar" if bar else "mbc"))
        T_stations.append(_place(rng, 1.0 if chain.n == 6 else 0.75))
        balls = [[8], [9]] * 2 if bar else [list(range(8))] * per_station
        if bar:
            postures = [_looks(true_chain, true_hand_eye, T_stations[-1], bar_balls[b - 8], rng, tilt_deg, 1)[0] for (b,) in balls]
        else:
            postures = _looks(true_chain, true_hand_eye, T_stations[-1], MBC.mean(axis=0), rng, tilt_deg, len(balls))
        for look, joints in zip(balls, postures, strict=True):
            pose += [len(q)] * len(look)
            ball += look
            q.append(joints)
            station.append(s)
            phase.append("verification" if bar else "position")
    if preliminary:
        for name, joints in _preliminary(chain, true_chain, true_hand_eye, T_stations[0], rng):
            pose += [len(q)] * 8
            ball += range(8)
            q.append(joints)
            station.append(0)
            phase.append(name)
    cell = Cell(robot(chain), HAND_EYE, tuple(artefacts), tuple(placed), noise_mm=np.array(noise) if stated else None)
    truth = CellState(true_chain, true_hand_eye, np.array(T_stations), cell.ball_centres)
    obs = Observations(
        cell,
        np.arange(len(q)),
        np.array(station),
        np.array(q),
        np.array(pose),
        np.array(ball),
        np.zeros((len(pose), 3)),
        phase=np.array(phase),
    )
    return Simulated(measure(obs, truth, rng, noise, joint_rad), truth, errors)


def measure(obs: Observations, truth: CellState, rng: np.random.Generator, noise, joint_rad: float) -> Observations:
    """New readings of the same poses: the joints stand off by the repeatability, every centre has scanner noise."""
    off = forward_model.Displacements(joint=rng.normal(size=obs.q.shape) * joint_rad)
    xyz = forward_model.predict(obs, truth, off).xyz
    return replace(obs, xyz=xyz + rng.normal(size=xyz.shape) * np.asarray(noise))


def tracker_cell(
    rng: np.random.Generator,
    poses: int = 300,
    *,
    orientation: bool = False,
    noise: float = 0.02,
    joint_rad: float = 0.0,
    turn: float = 5e-5,
) -> Simulated:
    """An external tracker measures a target on the flange."""
    chain = kr10()
    errors = random_errors(chain, rng)
    q = rng.uniform(-1, 1, size=(poses, 6)) * np.array([2.5, 0.8, 0.8, 2.5, 1.8, 2.5]) + np.array([0, -1.2, 1.5, 0, 0, 0])
    hand_eye = se3.exp(np.array([30.0, -20, 90, 0.4, -0.3, 0.2]) if orientation else np.array([30.0, -20, 90, 0, 0, 0]))
    station = se3.exp(np.array([[2000.0, -500, 300, 0.1, 0.2, 2.0]]))
    artefact = Artefact("tracker", "tracker", (1,), np.zeros((1, 3)), np.zeros(1))
    cell = Cell(robot(chain), np.eye(4), (artefact,), (Station("1", "tracker"),), noise_mm=np.full(3, noise), measurement=TARGET_IN_BASE)
    truth = CellState(chain.with_errors(errors), hand_eye, station, np.zeros((1, 3)))
    obs = Observations(
        cell,
        np.arange(poses),
        np.zeros(poses, int),
        q,
        np.arange(poses),
        np.zeros(poses, int),
        np.zeros((poses, 3)),
        rotation=np.tile(np.eye(3), (poses, 1, 1)) if orientation else None,
    )
    exact = forward_model.predict(obs, truth, forward_model.Displacements(joint=rng.normal(size=q.shape) * joint_rad))
    obs = replace(obs, xyz=exact.xyz + rng.normal(size=(poses, 3)) * noise)
    if orientation:
        obs = replace(obs, rotation=se3.rotation_exp(rng.normal(size=(poses, 3)) * turn) @ exact.rotation)
    return Simulated(obs, truth, errors)


def _place(rng: np.random.Generator, reach: float) -> np.ndarray:
    """An artefact in front of the arm, its z axis up."""
    angle = rng.uniform(-1.2, 1.2)
    radius, height = reach * rng.uniform(650, 950), reach * rng.uniform(0, 500)
    turn = se3.exp(np.concatenate([np.zeros(3), rng.normal(size=3) * 0.3]))[:3, :3]
    return se3.transform(turn, np.array([radius * np.cos(angle), radius * np.sin(angle), height]))


def _preliminary(nominal: Chain, true: Chain, hand_eye, T_base_station, rng):
    """Joint angles of the phases 'translation' and 'orientation' at one station."""
    centre = MBC.mean(axis=0)
    for _ in range(50):
        (first,) = _looks(true, hand_eye, T_base_station, centre, rng, 10.0, 1)
        T = nominal.flange(first[None])[0]
        moves = [se3.transform(np.eye(3), sign * 30.0 * axis) for axis in np.eye(3) for sign in (1, -1)]
        q, reached = _inverse(nominal, np.array(moves) @ T, np.tile(first, (6, 1)), exact=True)
        if reached.all():
            turned = _looks(true, hand_eye, T_base_station, centre, rng, 25.0, 6)
            return [("translation", joints) for joints in q] + [("orientation", joints) for joints in turned]
    raise AssertionError("no reachable translations found")


def _looks(chain: Chain, T_flange_scanner, T_base_station, centre, rng, tilt_deg: float, count: int) -> list[np.ndarray]:
    """Joint angles of ``count`` poses in which the scanner frame stands at ``centre``, z back at the scanner, tilted and rolled at random.

    Attempts are made many at a time; those after the last that is needed are as if they had never been drawn.
    """
    found: list[np.ndarray] = []
    for _ in range(200):
        before, wanted = rng.bit_generator.state, count - len(found)
        drawn = [_attempt(chain.n, centre, rng, tilt_deg) for _ in range(3 * wanted + 3)]
        T_station_scanner, start = (np.array(one) for one in zip(*drawn, strict=True))
        q, reached = _inverse(chain, T_base_station @ T_station_scanner @ se3.inverse(T_flange_scanner), start)
        good = np.flatnonzero(reached)[:wanted]
        found += list(q[good])
        if len(found) == count:
            rng.bit_generator.state = before
            for _ in range(good[-1] + 1):
                _attempt(chain.n, centre, rng, tilt_deg)
            return found
    raise AssertionError("no reachable pose found")


def _attempt(n: int, centre, rng, tilt_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose (4, 4) of the scanner at a station, and (n,) where the search for joint angles begins."""
    tilt = np.radians(tilt_deg) * rng.uniform(-1, 1, size=3) * np.array([1, 1, 3])
    T_station_scanner = se3.transform(se3.rotation_exp(tilt), centre + rng.normal(size=3) * 3)
    usual = np.array([0, -1.2, 1.5, 0, 0.9, 0]) if n == 6 else np.array([0, 0.7, 0, -1.4, 0, 1.0, 0])
    return T_station_scanner, rng.uniform(-1, 1, n) * 0.8 + usual


def inverse_kinematics(chain: Chain, target: np.ndarray, start: np.ndarray) -> np.ndarray | None:
    """Joint angles (n,) near ``start`` that bring the flange to ``target`` (4, 4); None where that fails."""
    q, reached = _inverse(chain, target[None], start[None], exact=True)
    return q[0] if reached[0] else None


def _inverse(chain: Chain, target: np.ndarray, start: np.ndarray, exact: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Numerical inverse kinematics: damped Gauss-Newton from starts (N, n) to targets (N, 4, 4). Angles (N, n), and whether each is reached."""
    scale, damping, tolerance = np.array([1e-3] * 3 + [1.0] * 3), (1e-6 if exact else 0.03), (1e-10 if exact else 1e-3)
    q, reached, going = start.copy(), np.zeros(len(start), dtype=bool), np.arange(len(start))
    for _ in range(60):
        frames = chain.frames(q[going])
        xi = scale * _twist(target[going], frames[:, -1])
        axis, point = frames[:, :-1, :3, 2], frames[:, :-1, :3, 3]
        J = scale * np.concatenate([_cross(point, axis), axis], axis=2) * chain.sign[:, None]  # (N, n, 6)
        step = np.linalg.solve(J @ np.swapaxes(J, 1, 2) + damping**2 * np.eye(chain.n), J @ xi[..., None])[..., 0]
        q[going] += np.clip(step, -0.3, 0.3)
        there = np.abs(xi).max(axis=1) < tolerance
        reached[going[there]] = exact or np.abs(q[going[there]]).max(axis=1) < 3
        going = going[~there]
        if not len(going):
            break
    return q, reached


def _twist(target: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """(N, 6) displacement mm and rotation vector rad that take ``reached`` to ``target``, both (N, 4, 4)."""
    R = target[:, :3, :3] @ np.swapaxes(reached[:, :3, :3], 1, 2)
    sine = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1) / 2
    size = np.sqrt(np.sum(sine**2, axis=1))
    angle = np.arctan2(size, (np.trace(R, axis1=1, axis2=2) - 1) / 2)
    rotation = sine * (angle / np.maximum(size, 1e-9))[:, None]
    if (special := (size <= 1e-9) | (angle >= 3.1)).any():
        rotation[special] = se3.rotation_log(R[special])
    return np.concatenate([target[:, :3, 3] - (R @ reached[:, :3, 3:])[..., 0], rotation], axis=1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(.., 3) cross products; numpy's own costs as much as all the rest where there are few."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


__all__ = [
    "ARTEFACT_IN_SCANNER",
    "Simulated",
    "iiwa",
    "inverse_kinematics",
    "kr10",
    "measure",
    "random_errors",
    "robot",
    "scanner_cell",
    "tracker_cell",
]
