"""Made cells with prismatic joints and external axes: an arm on a track, an arm at a turntable, a SCARA, a gantry with a wrist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from cells import BAR, MBC, Simulated, kr10

from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState, Displacements
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.chain_from_axes import carried, chain_from_axes
from mbcacq.geometry.numerical_inverse import NumericalInverse, SolverOptions
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations

OFF = 3.0  # mm by which looks miss the middle of the balls
DOWN = se3.transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
LOOKING = se3.transform(np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]]), np.array([1.0, -0.5, 265.0]))  # z back at the scanner
FAST = SolverOptions(table_size=2000, rounds=4, starts_per_round=12, quiet_rounds=1, most_branches=4)


def on_a_track() -> RobotModel:
    """A KR 10 class arm on a track of 4 m along x."""
    chain = carried(kr10(), np.array([[1.0, 0, 0]]), np.zeros((1, 3)), (0,), 0)
    return _robot(
        "arm on a track", chain, np.vstack([[[0.0, 4000.0]], np.tile([-3.0, 3.0], (6, 1))]), ("E1", *(f"A{i}" for i in range(1, 7)))
    )


def at_a_turntable() -> RobotModel:
    """A KR 10 class arm before a positioner that tilts about y and turns about the table's z."""
    direction, point = np.array([[0, 0, -1.0], [0, -1.0, 0]]), np.array([[900.0, 0, 0], [900.0, 0, 200]])
    chain = carried(kr10(), direction, point, (), 2)
    limits = np.vstack([[[-3.0, 3.0], [-0.6, 0.6]], np.tile([-3.0, 3.0], (6, 1))])
    return _robot("arm at a turntable", chain, limits, ("E2", "E1", *(f"A{i}" for i in range(1, 7))))


def gantry() -> RobotModel:
    """Three sliding axes and a wrist of three."""
    direction = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 0, 1]])
    flange = DOWN @ se3.transform(np.eye(3), np.array([0, 0, 200.0]))
    chain = chain_from_axes(direction, np.zeros((6, 3)), flange, (0, 1, 2)).chain
    return _robot("gantry", chain, np.array([[0, 2000.0], [0, 1500], [0, 1500], [-3, 3], [-1.2, 1.2], [-3, 3]]))


def scara() -> RobotModel:
    """Two parallel axes, a stroke and a turn."""
    d, a, alpha = np.array([400.0, 0, 0, 50.0]), np.array([450.0, 400, 0, 0]), np.array([0, np.pi, 0, 0])
    chain = Chain(np.ones(4), np.zeros(4), d, a, alpha, np.zeros(4), sliding=(2,))
    return _robot("SCARA", chain, np.array([[-2.2, 2.2], [-2.4, 2.4], [0.0, 300.0], [-3, 3]]))


def _robot(name: str, chain: Chain, limits: np.ndarray, names: tuple[str, ...] = ()) -> RobotModel:
    return RobotModel(name, chain, limits, np.zeros(chain.n), np.zeros((chain.n, 3)), repeatability_mm=0.04, names=names)


def link_errors(chain: Chain, rng: np.random.Generator) -> np.ndarray:
    """(n, 5) of the size of the paper's Table 1, zero where a parameter is redundant."""
    return rng.normal(size=(chain.n, 5)) * np.array([5e-4, 0.2, 0.2, 2e-4, 2e-4]) * ~chain.redundant()


def scanner_cell(
    robot: RobotModel,
    rng: np.random.Generator,
    centres: np.ndarray,
    per_station: int = 12,
    guide=None,
    noise=(0.005, 0.005, 0.009),
    joint_rad: float = 8e-6,
    joint_mm: float = 0.005,
) -> Simulated:
    """A scanner on the flange sees eight balls at stations whose centres (S, 3) mm are given in the base, from tilts about their normals.

    guide: twists (P, 6) behind the first joint at its positions (P,), or None.
    """
    errors = link_errors(robot.chain, rng)
    T_stations = np.array([_placed(rng, centre) for centre in centres])
    hand_eye = LOOKING @ se3.exp(rng.normal(size=6) * [1, 1, 1, 0.005, 0.005, 0.005])
    looks = np.array([[_look(T, rng) for _ in range(3 * per_station)] for T in T_stations]).reshape(-1, 4, 4) @ se3.inverse(LOOKING)
    found = NumericalInverse(robot.chain, robot.limits, FAST).branches(looks)
    q, station = [], []
    for s in range(len(centres)):
        own = [found[i] for i in range(3 * per_station * s, 3 * per_station * (s + 1)) if len(found[i])][:per_station]
        assert len(own) == per_station, "too few poses are reached"
        q += [each[rng.integers(len(each))] for each in own]
        station += [s] * per_station
    return measured(robot, errors, hand_eye, T_stations, np.array(q), np.array(station), rng, guide, noise, joint_rad, joint_mm)


def measured(robot, errors, hand_eye, T_stations, q, station, rng, guide=None, noise=(0.005, 0.005, 0.009), joint_rad=8e-6, joint_mm=0.005):
    """What the scanner measures of eight balls at these poses, with the truth."""
    artefact = Artefact("mbc", "MBC-8", tuple(range(1, 9)), MBC, np.full(8, 12.0))
    stations = tuple(Station(str(s + 1), "mbc") for s in range(len(T_stations)))
    cell = Cell(robot, LOOKING, (artefact,), stations, noise_mm=np.array(noise))
    count = len(q)
    obs = Observations(
        cell, np.arange(count), station, q, np.repeat(np.arange(count), 8), np.tile(np.arange(8), count), np.zeros((8 * count, 3))
    )
    truth = CellState(robot.chain.with_errors(errors), hand_eye, T_stations, cell.ball_centres)
    frame = np.zeros((count, robot.n + 1, 6))
    if guide is not None:
        frame[:, 1] = guide(q[:, 0])
    off = rng.normal(size=q.shape) * robot.chain.by_kind(joint_rad, joint_mm)
    exact = forward_model.predict(obs, truth, Displacements(joint=off, frame=frame)).xyz
    return Simulated(replace(obs, xyz=exact + rng.normal(size=exact.shape) * noise), truth, errors)


def tracker_cell(robot: RobotModel, rng: np.random.Generator, poses: int, noise: float = 0.02) -> Simulated:
    """A tracker measures a reflector on the flange at random positions of all joints."""
    errors = link_errors(robot.chain, rng)
    q = rng.uniform(*robot.limits.T, size=(poses, robot.n))
    artefact, target = Artefact("tracker", "tracker", (1,), np.zeros((1, 3)), np.zeros(1)), se3.exp(np.array([60.0, -30, 90, 0, 0, 0]))
    cell = Cell(
        robot,
        target @ se3.exp(np.array([0.5, 0.5, 0.1, 0, 0, 0])),
        (artefact,),
        (Station("1", "tracker"),),
        noise_mm=np.full(3, noise),
        measurement=TARGET_IN_BASE,
    )
    station = se3.exp(np.array([[2500.0, -1500, 300, 0.1, 0.2, 2.0]]))
    truth = CellState(robot.chain.with_errors(errors), target, station, np.zeros((1, 3)))
    obs = Observations(cell, np.arange(poses), np.zeros(poses, int), q, np.arange(poses), np.zeros(poses, int), np.zeros((poses, 3)))
    off = rng.normal(size=q.shape) * robot.chain.by_kind(8e-6, 0.005)
    exact = forward_model.predict(obs, truth, Displacements(joint=off)).xyz
    return Simulated(replace(obs, xyz=exact + rng.normal(size=(poses, 3)) * noise), truth, errors)


def _placed(rng: np.random.Generator, centre: np.ndarray) -> np.ndarray:
    return se3.transform(se3.rotation_exp(rng.normal(size=3) * 0.2), np.asarray(centre, dtype=float))


def _look(T_base_station: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """T_base_scanner of a look at the middle of the balls."""
    tilt = 0.5 * rng.uniform(-1, 1, size=3) * np.array([1, 1, 3])
    return T_base_station @ se3.transform(se3.rotation_exp(tilt), MBC.mean(axis=0) + rng.normal(size=3) * OFF)


def arm_error(found, cell: Simulated) -> tuple[np.ndarray, np.ndarray]:
    """Error (k,) of the free link parameters of a calibrated cell, and their stated covariance (k, k)."""
    block = found.layout.blocks[0]
    names = [name for name, free in zip(block.names, block.free, strict=True) if free and name in found.names]
    at = [block.names.index(name) for name in names]
    index = [found.names.index(name) for name in names]
    return (found.state.chain.rows - cell.truth.chain.rows).reshape(-1)[at], found.covariance[np.ix_(index, index)]


__all__ = ["BAR", "arm_error", "at_a_turntable", "gantry", "link_errors", "measured", "on_a_track", "scanner_cell", "scara", "tracker_cell"]
