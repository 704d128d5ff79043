"""Blind cells with one error of an external axis: is it named, and at the right axis? And is anything named where nothing is concealed?

    python benchmarks/external_effects.py [--cells 60] [--first 5000]

The cells are made here in plain numpy: lines of axes, rails and bearings, and what a scanner sees. Nothing of the tool takes part but the
description of the arm, which is given to both.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import bench  # noqa: F401  # the simulated cells of the tests
import joint_cells as described
import numpy as np
from cells import MBC

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.geometry.numerical_inverse import NumericalInverse
from mbcacq.model.cell import Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations

NOISE = np.array([0.005, 0.005, 0.009])
described.OFF = 25.0  # mm by which looks miss the middle of the balls: the field of view tells lengths
STATIONS, VIEWS, LENGTH = 10, 12, 4000.0
KINDS = {
    "track": ("scale", "horizontal straightness", "vertical straightness", "yaw", "pitch", "nothing"),
    "table": ("wobble", "run-out", "gear", "nothing"),
}
NAMES = {"scale": "joint_scale", "gear": "gear_transmission_error", "nothing": ""}


@dataclass(frozen=True)
class Blind:
    """What was concealed and where, and how strong."""

    kind: str
    axis: str
    size: float


def turn(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(P, 4, 4): Rodrigues' formula."""
    K = np.cross(np.eye(3), np.asarray(axis, dtype=float))
    out = np.tile(np.eye(4), (len(angle), 1, 1))
    out[:, :3, :3] += np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K)
    return out


def shift(vector: np.ndarray) -> np.ndarray:
    """(P, 4, 4) from (P, 3) mm."""
    out = np.tile(np.eye(4), (len(vector), 1, 1))
    out[:, :3, 3] = vector
    return out


def about(point: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """A motion about a point of the base."""
    there = np.eye(4)
    there[:3, 3] = point
    return there @ motion @ np.linalg.inv(there)


def rail(rng: np.random.Generator, size: float, s: np.ndarray) -> np.ndarray:
    """(P,) a rail's error at s mm: waves of 1.3 to 5 m, as its supports stand, of the given root mean square."""
    waves = [(rng.normal(), rng.uniform(1300, 5000), rng.uniform(0, 2 * np.pi)) for _ in range(3)]
    along = np.linspace(0, LENGTH, 400)
    curve = lambda x: sum(a * np.sin(2 * np.pi * x / L + p) for a, L, p in waves)  # noqa: E731
    straight = np.polyfit(along, curve(along), 1)
    rms = np.std(curve(along) - np.polyval(straight, along))
    return size * (curve(s) - np.polyval(straight, s)) / rms


def track_motion(blind: Blind, rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    """(P, 4, 4) of the carriage on rails along x; its middle is 300 mm below the arm's foot."""
    s, none = q[:, 0], np.zeros(len(q))
    moved = np.column_stack([s * (1 + blind.size) if blind.kind == "scale" else s, none, none])
    error = rail(rng, blind.size, s)
    if "straightness" in blind.kind:
        moved[:, 1 if "horizontal" in blind.kind else 2] += error
    tilt = {"yaw": [0, 0, 1], "pitch": [0, 1, 0]}.get(blind.kind)
    return shift(moved) if tilt is None else shift(moved) @ about(np.array([0, 0, -300.0]), turn(tilt, error))


def table_motion(blind: Blind, rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
    """(P, 4, 4) of the floor as the table sees it: the table turns about z at x 900 after it was tilted about y."""
    angle, tilted = -q[:, 0].copy(), -q[:, 1].copy()
    lobes, phase = int(rng.integers(2, 4)), rng.uniform(0, 2 * np.pi)
    own, point = (angle, np.array([900.0, 0, 0])) if blind.axis == "E2" else (tilted, np.array([900.0, 0, 200.0]))
    wave = np.column_stack([np.cos(lobes * own + phase), np.sin(lobes * own + phase)])
    error = np.tile(np.eye(4), (len(q), 1, 1))
    if blind.kind == "gear":
        own += blind.size * wave[:, 0]
    elif blind.kind == "wobble":
        error = about(point, turn([1.0, 0, 0], blind.size * wave[:, 0]) @ turn([0, 1.0, 0], blind.size * wave[:, 1]))
    elif blind.kind == "run-out":
        error = shift(blind.size * np.column_stack([wave, np.zeros(len(q))]))
    return error @ about(np.array([900.0, 0, 0]), turn([0, 0, 1.0], angle)) @ about(np.array([900.0, 0, 200.0]), turn([0, 1.0, 0], tilted))


def flange(robot: RobotModel, rows: np.ndarray, external: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(P, 4, 4): the arm's own rows (6, 5) of theta, d, a, alpha, beta behind what moves its foot."""
    T = external
    for i, (theta, d, a, alpha, beta) in enumerate(rows):
        T = T @ turn([0, 0, 1.0], robot.chain.sign[-6 + i] * q[:, -6 + i] + theta) @ shift(np.array([[0, 0, d]]))
        T = T @ shift(np.array([[a, 0, 0]])) @ turn([1.0, 0, 0], np.array([alpha])) @ turn([0, 1.0, 0], np.array([beta]))
    return T


def made(cell: str, seed: int) -> tuple[Blind, Observations]:
    """A cell and what is concealed in it."""
    rng = np.random.default_rng([seed, 64])
    kind = KINDS[cell][seed % len(KINDS[cell])]
    robot = described.on_a_track() if cell == "track" else described.at_a_turntable()
    size = float(np.exp(rng.uniform(0, np.log(4))))
    unit = {"scale": 30e-6, "run-out": 0.03, "wobble": 5e-5, "gear": 5e-5, "yaw": 5e-5, "pitch": 5e-5}.get(kind, 0.04)
    blind = Blind(kind, "E1" if cell == "track" else "E2", 0.0 if kind == "nothing" else size * unit)
    if cell == "track":
        side = rng.uniform(500, 800, STATIONS) * np.array([1, -1] * (STATIONS // 2))
        centres = np.column_stack([np.linspace(300, LENGTH + 300, STATIONS), side, rng.uniform(0, 500, STATIONS)])
    else:
        centres = np.array([900.0, 0, 250]) + rng.uniform(-1, 1, (STATIONS, 3)) * [250, 250, 150]
    placed = np.array([described._placed(rng, c) for c in centres])
    looks = np.array([[described._look(T, rng) for _ in range(3 * VIEWS)] for T in placed]).reshape(-1, 4, 4)
    found = NumericalInverse(robot.chain, robot.limits, described.FAST).branches(looks @ np.linalg.inv(described.LOOKING))
    q, station = [], []
    for s in range(STATIONS):
        own = [f for f in found[3 * VIEWS * s : 3 * VIEWS * (s + 1)] if len(f)][:VIEWS]
        q += [each[rng.integers(len(each))] for each in own]
        station += [s] * len(own)
    q, station = np.array(q), np.array(station)
    errors = rng.normal(size=(6, 5)) * np.array([3e-4, 0.15, 0.15, 1.5e-4, 0.0])
    true = q + rng.normal(size=q.shape) * robot.chain.by_kind(8e-6, 0.005)
    outer = (track_motion if cell == "track" else table_motion)(blind, rng, true)
    rows = np.column_stack([described.kr10().theta, described.kr10().d, described.kr10().a, described.kr10().alpha, described.kr10().beta])
    T_scanner = flange(robot, rows + errors, outer, true) @ described.LOOKING @ shift(rng.normal(size=(1, 3)))
    balls = placed[station] @ np.concatenate([MBC, np.ones((8, 1))], axis=1).T
    seen = np.swapaxes(np.linalg.inv(T_scanner) @ balls, 1, 2)[..., :3].reshape(-1, 3)
    artefact = Artefact("mbc", "MBC-8", tuple(range(1, 9)), MBC, np.full(8, 12.0))
    stations = tuple(Station(str(s + 1), "mbc") for s in range(STATIONS))
    count = len(q)
    pose, ball = np.repeat(np.arange(count), 8), np.tile(np.arange(8), count)
    obs = Observations(
        Cell(robot, described.LOOKING, (artefact,), stations, noise_mm=NOISE),
        np.arange(count),
        station,
        q,
        pose,
        ball,
        np.zeros((8 * count, 3)),
    )
    return blind, replace(obs, xyz=seen + rng.normal(size=seen.shape) * NOISE)


def main(cells: int, first: int) -> None:
    right: list[bool] = []
    for seed in range(first, first + cells):
        cell = ("track", "table")[seed // 6 % 2]
        blind, obs = made(cell, seed)
        found = diagnose(obs)
        named = [(e.name, "+".join(e.where)) for e in found.effects if e.name != "unknown"]
        wanted = [] if blind.kind == "nothing" else [(NAMES.get(blind.kind, "axis_error_motion"), blind.axis)]
        right.append(named == wanted)
        words = ", ".join(f"{n} at {w} {list(e.parameters)}" for (n, w), e in zip(named, found.effects, strict=False)) or "nothing"
        unnamed = [e.where for e in found.effects if e.name == "unknown"]
        print(
            f"{seed} {cell} {blind.kind} {blind.size:.3g}: {words} {unnamed or ''} {found.verdict} {'right' if right[-1] else 'WRONG'}",
            flush=True,
        )
    print(f"named and placed, or nothing where nothing is: {sum(right)} of {len(right)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=60)
    parser.add_argument("--first", type=int, default=5004)
    main(**vars(parser.parse_args()))
