"""Steps -> targets: one a pose, still without joint angles (unless they were taught)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mbcacq.geometry import se3
from mbcacq.model.cell import Artefact
from mbcacq.plan.field_of_view import T_base_scanner, margin
from mbcacq.plan.planned import LoadedPlan
from mbcacq.plan.schema import Look, Taught, Translate, View


@dataclass(frozen=True)
class Target:
    """One pose to take. T_base_flange: (4, 4), or None where ``q`` (n,) rad was taught. balls: expected ids. centre: (3,) mm, aimed at,
    station frame. where: path of the view, offset or joint vector in the YAML."""

    step: int
    station: str
    T_base_flange: np.ndarray | None
    q: np.ndarray | None
    balls: tuple[int, ...]
    centre: np.ndarray | None
    wrist: str
    where: tuple[str | int, ...]


def targets(loaded: LoadedPlan) -> list[Target]:
    """All poses of a plan in the order of its YAML: step by step, station by station, ball by ball, view by view."""
    out: list[Target] = []
    for index, step in enumerate(loaded.plan.steps):
        expand = {Translate: _translate, Look: _look, Taught: _taught}[type(step)]
        out.extend(expand(loaded, index, step))
    return out


def seen(loaded: LoadedPlan, station: str, T_base_flange: np.ndarray) -> tuple[int, ...]:
    """Balls of the artefact at a station that lie wholly in the field of view at a flange pose (4, 4)."""
    place = _station(loaded, station)
    artefact = loaded.cell.artefact(place.artefact)
    xyz = se3.apply(se3.inverse(T_base_flange @ loaded.cell.T_flange_scanner) @ place.T_base_station, artefact.centres)
    inside = margin(loaded.plan.scanner.field_of_view, xyz, artefact.diameters / 2) >= 0
    return tuple(ball for ball, yes in zip(artefact.ball_ids, inside, strict=True) if yes)


def _aim(loaded: LoadedPlan, step: int, station: str, centre: np.ndarray, view: View, where, offset=(0.0, 0.0, 0.0)) -> Target:
    scanner = T_base_scanner(_station(loaded, station).T_base_station, centre, view)
    scanner[:3, 3] += offset
    flange = scanner @ se3.inverse(loaded.cell.T_flange_scanner)
    return Target(step, station, flange, None, seen(loaded, station, flange), centre, view.wrist, where)


def _translate(loaded: LoadedPlan, index: int, step: Translate) -> Iterator[Target]:
    station = str(step.station)
    centre = _artefact(loaded, station).centres.mean(axis=0)
    for i, offset in enumerate(step.offsets_mm):
        yield _aim(loaded, index, station, centre, step.view, ("steps", index, "offsets_mm", i), offset)


def _look(loaded: LoadedPlan, index: int, step: Look) -> Iterator[Target]:
    for station in map(str, step.stations):
        for centre in aims(_artefact(loaded, station), step.balls):
            for i, view in enumerate(step.views):
                yield _aim(loaded, index, station, centre, view, ("steps", index, "views", i))


def aims(artefact: Artefact, balls: str | tuple[int, ...]) -> np.ndarray:
    """(k, 3) mm points to look at: the middle of all balls, each ball, or certain ones."""
    if balls == "all":
        return artefact.centres.mean(axis=0)[None]
    return artefact.centres if balls == "each" else artefact.centres[[artefact.ball_ids.index(b) for b in balls]]


def _taught(loaded: LoadedPlan, index: int, step: Taught) -> Iterator[Target]:
    station = str(step.station)
    for i, pose in enumerate(step.poses_deg):
        q = np.radians(pose)
        balls = step.balls or seen(loaded, station, loaded.cell.robot.chain.flange(q[None])[0])
        yield Target(index, station, None, q, balls, None, "any", ("steps", index, "poses_deg", i))


def _station(loaded: LoadedPlan, station: str):
    return next(s for s in loaded.cell.stations if s.id == station)


def _artefact(loaded: LoadedPlan, station: str):
    return loaded.cell.artefact(_station(loaded, station).artefact)
