"""What a run of the fake cell would record, without protocols and pictures: for thousands of simulated cells in Monte Carlo studies.

The same arm, repeatability, effects and centre noise as the real fake cell; a ball's centre is where a sphere of known radius fits
the displaced visible cap. Agreement with the rendered frames is tested.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbcacq_fakes.cell.build_world import make_world
from mbcacq_fakes.world.description import CellFacts, from_cell
from mbcacq_fakes.world.hooks import Moments, NoEffect
from mbcacq_fakes.world.options import FakeOptions, parse
from mbcacq_fakes.world.world import World

OBSERVED = 7


@dataclasses.dataclass(frozen=True, kw_only=True)
class ComputedRun:
    """Poses: q (P, n) rad as reported, station (P,) index into the cell's stations, time_s (P,), direction (P, n), air_C, robot_C
    (P,). Centres: pose (M,), ball (M,) index over all balls of the cell, xyz (M, 3) mm in the scanner frame. outlier: (M,) bool.
    truth: see World.truth.
    """

    q: np.ndarray
    station: np.ndarray
    time_s: np.ndarray
    direction: np.ndarray
    air_C: np.ndarray
    robot_C: np.ndarray
    pose: np.ndarray
    ball: np.ndarray
    xyz: np.ndarray
    outlier: np.ndarray
    truth: dict[str, Any]


def observe(  # noqa: PLR0913 -- one argument a property of the run
    cell: Any,
    poses: Sequence[Any],
    hidden: Sequence[Mapping[str, Any]] = (),
    seed: int = 0,
    *,
    fake: Mapping[str, Any] | None = None,
    exposures: int | None = None,
    pace_s: float = 20.0,
    outliers: float = 0.0,
    planned_q: np.ndarray | None = None,
) -> ComputedRun:
    """cell: a Cell with planned station poses, or CellFacts. poses: PlannedPose (q, station, balls, exposures), in order.

    hidden: as in a plan's ``fake: hidden``. fake: more options of that section. exposures: averaged per pose; default the plan's.
    pace_s: mean time from pose to pose. outliers: share of the centres that are off by 0.2 to 2 mm. planned_q: (P', n) rad of the poses by
    which injected effects choose where and when they act; default those that are measured. A cell that is measured again stays the same
    with those of the first time. Raises ConfigError.
    """
    facts = cell if isinstance(cell, CellFacts) else from_cell(cell)
    q = np.array([p.q for p in poses], dtype=float)
    facts = dataclasses.replace(facts, planned_q=q if planned_q is None else planned_q, pace_s=pace_s)
    options: FakeOptions = parse({**(fake or {}), "hidden": list(hidden)})
    world = make_world(facts, options, seed)
    rng = world.noise(OBSERVED)
    station = np.array([facts.station_ids.index(str(p.station)) for p in poses])
    q = q + 1e-5 * rng.standard_normal(q.shape)  # a controller stops near its target and says exactly where
    time_s = np.cumsum(rng.uniform(0.6, 1.4, len(q)) * pace_s)
    before = np.concatenate([q[:1] - 1e-3 * rng.choice([-1, 1], (1, facts.n)), q[:-1]])
    at = world.moments(q, np.zeros_like(q), np.sign(q - before), np.arange(len(q)), time_s, station, facts.station_artefact[station])
    pose, ball, xyz = _true_centres(world, at, [tuple(p.balls) for p in poses])
    shots = np.array([p.exposures if exposures is None else exposures for p in poses])
    xyz = xyz + np.array(options.noise_mm) / np.sqrt(shots[pose])[:, None] * rng.standard_normal(xyz.shape)
    gross = rng.random(len(xyz)) < outliers
    away = rng.standard_normal((int(gross.sum()), 3))
    xyz[gross] += rng.uniform(0.2, 2.0, (len(away), 1)) * away / np.linalg.norm(away, axis=1, keepdims=True)
    return ComputedRun(
        q=q,
        station=station,
        time_s=at.time_s,
        direction=at.direction,
        air_C=at.air_C,
        robot_C=at.robot_C,
        pose=pose,
        ball=ball,
        xyz=xyz,
        outlier=gross,
        truth=world.truth(),
    )


def _true_centres(world: World, at: Moments, wanted: list[tuple[int, ...]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """pose (M,), ball (M,), centres (M, 3) as fitted; ``wanted`` (P) ball ids in view, () for all of the artefact."""
    moved = world.displaced(at)
    pose, ball, xyz, radius = [], [], [], []
    for a, artefact in enumerate(world.artefacts):
        here = np.flatnonzero(at.artefact == a)
        if not len(here):
            continue
        centres = world.balls_in_scanner(_select(at, here), _select(moved, here), a)
        in_view = np.array([[not wanted[p] or b in wanted[p] for b in artefact.balls] for p in here], dtype=bool)
        p, b = np.nonzero(in_view)
        pose.append(here[p])
        ball.append(world.first_ball[a] + b)
        xyz.append(centres[p, b])
        radius.append(artefact.radii[b])
    pose, ball, xyz, radius = (np.concatenate(v) for v in (pose, ball, xyz, radius))
    order = np.lexsort((ball, pose))
    pose, ball, xyz, radius = pose[order], ball[order], xyz[order], radius[order]
    return pose, ball, xyz + _fitted_warp(world, at, pose, xyz, radius)


def _fitted_warp(world: World, at: Moments, pose: np.ndarray, centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(M, 3) shift of fitted centres by what the scanner does to the points of the visible cap; least squares, known radius."""
    if all(type(e).warp is NoEffect.warp for e in world.effects):
        return np.zeros_like(centre)
    normal = cap(48)
    points = centre[:, None] + radius[:, None, None] * normal
    shifted = world.warp(points.reshape(-1, 3), np.repeat(pose, len(normal)), at).reshape(points.shape)
    outward = np.einsum("mkc,kc->mk", shifted - points, normal)
    return outward @ np.linalg.pinv(normal).T


def cap(n: int, widest_deg: float = 62.0) -> np.ndarray:
    """(n, 3) directions spread evenly over the cap of a sphere that faces the scanner (+z)."""
    height = 1 - (np.arange(n) + 0.5) / n * (1 - np.cos(np.radians(widest_deg)))
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)


def _select(columns: Any, rows: np.ndarray) -> Any:
    return type(columns)(**{f.name: getattr(columns, f.name)[rows] for f in dataclasses.fields(columns)})
