"""Cells simulated for tests: the poses of a plan, known geometry, noise and effects, observed through the forward model."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.described import parts_of
from mbcacq.effects.effect import Candidate, StandstillRows, plain_report
from mbcacq.effects.support import with_drives_for
from mbcacq.estimation import forward_model, initial_guess
from mbcacq.estimation.forward_model import CellState, Displacements
from mbcacq.estimation.terms import Part, accumulate, term
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations

JOINT_NOISE, TURN_NOISE = 5e-6, 5e-5
POINT_NOISE = np.array([0.005, 0.005, 0.009])


def robot() -> RobotModel:
    """A six-axis arm of the ten-kilogram class with masses and gear ratios."""
    deg = np.pi / 180
    chain = Chain(
        np.array([-1.0, 1, 1, -1, 1, -1]),
        np.array([0, 0, -90, 0, 0, 180]) * deg,
        np.array([450.0, 0, 0, 660, 0, 80]),
        np.array([150.0, 610, 20, 0, 0, 0]),
        np.array([-90, 0, -90, 90, -90, 180]) * deg,
        np.zeros(6),
    )
    limits = np.array([[-170, 170], [-185, 65], [-137, 163], [-185, 185], [-120, 120], [-350, 350]]) * deg
    com = np.array([[0.0, 0, 0], [-240, 0, 0], [0, 0, 120], [0, 200, 0], [0, 0, 0], [0, 0, -20]])
    return RobotModel(
        "simulated arm",
        chain,
        limits,
        np.array([0, 38, 24, 9, 5, 0.5]),
        com,
        gear_ratio=np.array([119.2, 126.1, 99.6, 80, 80.9, 50.4]),
        payload_mass=3.0,
        payload_com=np.array([-5.0, 3, 110]),
        repeatability_mm=0.04,
    )


def cell(stations: int, bars: int, rng: np.random.Generator) -> Cell:
    balls = rng.uniform(-38, 38, (8, 3)) * [1, 1, 0.4]
    mbc = Artefact("mbc", "MBC-8", tuple(range(1, 9)), balls, np.full(8, 12.0))
    bar = Artefact("bar", "scale bar", (9, 10), np.array([[-400.0, 0, 0], [400.0, 0, 0]]), np.full(2, 25.0))
    hand_eye = se3.transform(se3.rotation_exp(np.array([np.pi, 0.0, 0.0])), np.array([0.0, 0.0, 260.0]))
    all_stations = tuple(Station(str(i + 1), "mbc") for i in range(stations)) + tuple(
        Station(str(stations + i + 1), "bar") for i in range(bars)
    )
    return Cell(robot(), hand_eye, (mbc, bar), all_stations, "simulated scanner", POINT_NOISE)


def joints(arm: RobotModel, T: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Newton from q (P, n) to flange poses T (P, 4, 4): angles, and (P,) bool of those reached within limits."""
    for _ in range(40):
        frames = arm.chain.frames(q)
        error = T @ se3.inverse(frames[:, -1])
        twist = np.concatenate([error[:, :3, 3], se3.rotation_log(error[:, :3, :3])], axis=1)
        J = np.swapaxes(arm.chain.joint_twists(frames), 1, 2)
        scale = np.array([1e-3, 1e-3, 1e-3, 1, 1, 1])
        J, twist = J * scale[:, None], twist * scale
        step = np.linalg.solve(np.swapaxes(J, 1, 2) @ J + 1e-9 * np.eye(arm.n), (np.swapaxes(J, 1, 2) @ twist[:, :, None]))[:, :, 0]
        q = q + step * np.minimum(1.0, 0.4 / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
    there = np.abs(arm.chain.frames(q)[:, -1] - T).max(axis=(1, 2)) < 1e-6
    return q, there & np.all((q > arm.limits[:, 0]) & (q < arm.limits[:, 1]), axis=1)


@cache
def plan(stations: int = 9, bars: int = 6, each: int = 8, seed: int = 7) -> Observations:
    """A plan that makes every effect observable: stations over a wide range of postures, several tilts and rolls each, and a long bar seen end by end.

    The measured centres are those of the nominal cell; ``observe`` replaces them.
    """
    rng = np.random.default_rng(seed)
    here = cell(stations, bars, rng)
    arm, q, station, pose, ball, xyz = here.robot, [], [], [], [], []
    for s, target_station in enumerate(here.stations):
        targets = [np.arange(8)] if target_station.artefact == "mbc" else [np.array([8]), np.array([9])]
        while True:
            start = rng.uniform(0.6 * arm.limits[:, 0], 0.6 * arm.limits[:, 1])
            T_base_scanner = arm.chain.frames(start[None])[0, -1] @ here.T_flange_scanner
            facing = se3.transform(
                se3.rotation_exp(rng.normal(0, 0.2, 3)), -here.ball_centres[targets[0]].mean(axis=0) * (len(targets) > 1)
            )
            T_base_station = T_base_scanner @ facing
            reached = []
            for seen in targets:
                centre = here.ball_centres[seen].mean(axis=0) * (len(targets) > 1)
                turn = se3.rotation_exp(rng.uniform(-1, 1, (40, 3)) * [0.7, 0.7, 3.0])
                T = (
                    T_base_station
                    @ se3.transform(np.eye(3), centre)
                    @ se3.inverse(facing @ se3.transform(np.eye(3), centre))[None]
                    @ se3.transform(turn, np.zeros(3))
                )
                found, good = joints(arm, T @ se3.inverse(here.T_flange_scanner), np.tile(start, (40, 1)) + rng.normal(0, 0.1, (40, 6)))
                reached.append(found[good])
            need = each // len(targets)
            if all(len(r) >= need for r in reached):
                break
        for seen, found in zip(targets, reached, strict=True):
            for one in found[:need]:
                T_scanner_base = se3.inverse(arm.chain.frames(one[None])[0, -1] @ here.T_flange_scanner)
                points = se3.apply(T_scanner_base @ T_base_station, here.ball_centres[seen])
                pose += [len(q)] * len(seen)
                ball += list(seen)
                xyz.append(points)
                q.append(one)
                station.append(s)
    count = len(q)
    time = np.cumsum(rng.uniform(12, 28, count))
    direction = np.sign(np.diff(np.array(q), axis=0, prepend=np.array(q)[:1] - 1))
    warm = 24 + 6 * (1 - np.exp(-time / 1200)) + rng.normal(0, 0.02, count)
    return Observations(
        here,
        np.arange(count),
        np.array(station),
        np.array(q),
        np.array(pose),
        np.array(ball),
        np.concatenate(xyz),
        time_s=time,
        direction=direction,
        temperatures={"robot_C": warm},
    )


def tracked(q: np.ndarray) -> Observations:
    """Poses q (P, n) of the nominal arm, whose flange carries a target that a tracker measures with its orientation."""
    arm, pose, none = robot(), np.arange(len(q)), np.zeros(len(q), int)
    tool = se3.transform(se3.rotation_exp(np.array([0.2, 0.1, 0.3])), np.array([30.0, 20.0, 180.0]))
    tracker = se3.transform(se3.rotation_exp(np.array([0.0, 0.0, 0.3])), np.array([2500.0, 300.0, 400.0]))
    target = Artefact("target", "target", (1,), np.zeros((1, 3)), np.zeros(1))
    here = Cell(arm, tool, (target,), (Station("1", "target"),), "tracker", POINT_NOISE, measurement=TARGET_IN_BASE)
    blank = Observations(here, pose, none, q, pose, none, np.zeros((len(q), 3)), rotation=np.tile(np.eye(3), (len(q), 1, 1)))
    seen = forward_model.predict(blank, CellState(arm.chain, tool, tracker[None], np.zeros((1, 3))))
    return replace(blank, xyz=seen.xyz, rotation=seen.rotation)


def geometry(rng: np.random.Generator, template: Cell) -> np.ndarray:
    """(n, 5) errors of the size a new arm has."""
    errors = rng.normal(0, [4e-4, 0.15, 0.15, 1e-4, 1e-4], (template.robot.n, 5))
    errors[:, 4] *= template.robot.chain.parallel_next()
    return errors


def nominal_state(obs: Observations) -> CellState:
    """The arm and the hand-eye as stated, the stations where the measured points put them then."""
    robot, T_flange_scanner = obs.cell.robot, obs.cell.T_flange_scanner
    stations = initial_guess.place_stations(obs, robot.chain.flange(obs.q), T_flange_scanner)[0]
    return CellState(robot.chain, T_flange_scanner, stations, obs.cell.ball_centres.copy())


def observe(
    template: Observations,
    seed: int,
    effects=(),
    outliers: float = 0.0,
    joint_noise: float = JOINT_NOISE,
    arm: int | None = None,
    drives: bool = True,
) -> Observations:
    """The poses of a recording measured again in another cell.

    effects: [(name, where, coefficients, hyper)] of the catalogue, put into the forward model; or functions of the context that
    return displacements. outliers: share of centres that are off by millimetres. arm: seed of the arm's errors, of one arm on several days.
    drives: whether the robot file states the drives by which its joints can have these effects.
    """
    rng = np.random.default_rng(seed)
    obs = template
    start = nominal_state(obs)
    state = CellState(
        obs.cell.robot.chain.with_errors(geometry(rng if arm is None else np.random.default_rng(arm), obs.cell)),
        obs.cell.T_flange_scanner @ se3.exp(rng.normal(0, [1, 1, 1, 0.01, 0.01, 0.01])),
        start.T_base_station,
        obs.cell.ball_centres + rng.normal(0, 0.001, (len(obs.cell.ball_ids), 3)),
    )
    if obs.cell.measurement == "artefact_in_scanner":
        state = replace(state, T_base_station=start.T_base_station)
    context = Context(obs, state, forward_model.predict(obs, state))
    terms, values, moved = [], [], Displacements()
    for effect in effects:
        if callable(effect):
            moved = add(moved, effect(context))
            continue
        name, where, coefficients, hyper = effect
        candidate = next(
            c for c in catalogue.candidates(context)[0] if c.name == name and c.where == tuple(where) and c.k == len(coefficients)
        )
        terms.append(term(name, parts_of(candidate, context, hyper)))
        values.append(np.asarray(coefficients, dtype=float))
    moved = add(moved, accumulate(obs, terms, values))
    moved = add(moved, Displacements(joint=rng.normal(0, joint_noise, obs.q.shape)))
    seen = forward_model.predict(obs, state, moved)
    xyz = seen.xyz + rng.normal(0, 1, obs.xyz.shape) * (POINT_NOISE if obs.cell.noise_mm is None else obs.cell.noise_mm)
    wrong = rng.random(len(xyz)) < outliers
    xyz[wrong] += rng.normal(0, 3.0, (int(wrong.sum()), 3))
    if drives:
        arm_of = obs.cell.robot
        for name, where, *_ in (one for one in effects if not callable(one)):
            arm_of = with_drives_for(arm_of, name, tuple(where))
        obs = replace(obs, cell=replace(obs.cell, robot=arm_of))
    if seen.rotation is None:
        return replace(obs, xyz=xyz)
    return replace(obs, xyz=xyz, rotation=se3.rotation_exp(rng.normal(0, TURN_NOISE, xyz.shape)) @ seen.rotation)


def candidate(name: str, where: str, typical: list[float], depends_on: str = "pose", **options) -> Candidate:
    """A candidate without parts, for rules that ask only what it is."""
    return Candidate(name, (where,), depends_on, StandstillRows(no_parts, np.array(typical)), plain_report("size"), **options)


def no_parts(_: float | None) -> list[Part]:
    return []


def add(a: Displacements, b: Displacements) -> Displacements:
    def both(x, y):
        return y if x is None else x if y is None else x + y

    return Displacements(*(both(getattr(a, k), getattr(b, k)) for k in ("joint", "frame", "point", "ball", "station")))
