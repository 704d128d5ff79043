"""Stations that the arm cannot serve, moved to the nearest place where it can; and views that no place helps, left out."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from mbcacq.plan import LoadedPlan
from mbcacq.plan.expansion import Target, expand_reachable, targets
from mbcacq.plan.loader import load
from mbcacq.plan.routing import router_of
from mbcacq.plan.schema import Look

DISTANCES_MM = (20, 40, 60, 80, 100, 130, 160, 200, 240, 280, 320, 360, 400, 450, 500, 550, 600, 700, 800, 1000)
DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


@dataclass(frozen=True, kw_only=True)
class StationMove:
    """A station with views out of reach. place: (3,) mm where all its views can be reached, nearest to the planned one, or None where
    there is none within the distances tried. unreachable, views: how many, now."""

    station: str
    line: int
    unreachable: int
    views: int
    place: np.ndarray | None
    distance_mm: float

    def sentence(self) -> str:
        what = f"station '{self.station}': {self.unreachable} of {self.views} views are out of reach"
        if self.place is None:
            return f"{what}, and no place within {DISTANCES_MM[-1]} mm lets all of them be taken; `--fix` leaves those views out"
        where = ", ".join(f"{v:.0f}" for v in self.place)
        return f"{what}; the nearest place where all can be taken is [{where}], {self.distance_mm:.0f} mm away; `--fix` writes it"


def station_moves(loaded: LoadedPlan) -> list[StationMove]:
    """One entry a station that has views out of reach."""
    lost = [t for t in expand_reachable(loaded)[1] if t.T_base_flange is not None]
    wanted = [t for t in targets(loaded) if t.T_base_flange is not None]
    out = []
    for station in dict.fromkeys(t.station for t in lost):
        own = [t for t in wanted if t.station == station]
        index = next(i for i, s in enumerate(loaded.plan.stations) if str(s.id) == station)
        offset = _nearest_offset(loaded, own)
        place = None if offset is None else np.round(loaded.cell.station(station).planned_pose[:3, 3] + offset)
        count = sum(t.station == station for t in lost)
        line, moved = loaded.lines.get(("stations", index), 1), 0.0 if offset is None else float(np.linalg.norm(offset))
        out.append(StationMove(station=station, line=line, unreachable=count, views=len(own), place=place, distance_mm=moved))
    return out


def _nearest_offset(loaded: LoadedPlan, own: list[Target]) -> np.ndarray | None:
    """The shortest of the offsets (3,) mm tried by which all targets of a station can be reached with nothing too close to the arm. If
    there is none, the shortest by which they can be reached."""
    solver, clearance, reached = router_of(loaded).solver, router_of(loaded).clearance, None
    wrist = loaded.cell.robot.n - 2
    T = np.stack([t.T_base_flange for t in own if t.T_base_flange is not None])
    signs = [{"any": 0, "positive": 1, "negative": -1}[t.wrist] for t in own]
    inwards = -T[:, :3, 3].mean(axis=0)
    order = np.argsort(-(DIRECTIONS @ inwards), kind="stable")  # towards the arm first
    for distance in DISTANCES_MM:
        for direction in DIRECTIONS[order]:
            moved = T.copy()
            moved[:, :3, 3] += np.round(distance * direction)
            # One view tells most places that will not do; the others are asked for the rest.
            if not any(signs[0] * q[wrist] >= 0 for q in solver.solutions(moved[:1])[0]):
                continue
            found = [q[sign * q[:, wrist] >= 0] for q, sign in zip(solver.solutions(moved), signs, strict=True) if len(q)]
            if len(found) < len(signs) or not all(map(len, found)):
                continue
            if all(any(clearance.at(q, None).distance >= loaded.plan.clearance_mm for q in of) for of in found):
                return np.round(distance * direction)
            reached = np.round(distance * direction) if reached is None else reached
    return reached


def repaired(loaded: LoadedPlan) -> tuple[LoadedPlan, list[str]]:
    """The plan with its unreachable stations moved and what then is still out of reach left out; and a sentence about each change."""
    said = []
    for move in station_moves(loaded):
        if move.place is None:
            continue
        text = _with_place(loaded, move)
        if text is not None:
            said.append(f"station '{move.station}' was moved by {move.distance_mm:.0f} mm to [{', '.join(f'{v:.0f}' for v in move.place)}]")
            loaded = _again(loaded, text)
    lost = [t for t in expand_reachable(loaded)[1] if isinstance(loaded.plan.steps[t.step], Look)]
    if lost:
        lines = {loaded.lines[t.where] for t in lost}
        text = without_lines(loaded, lines)
        if text is not None:
            said.append(f"{len(lines)} views that cannot be reached were left out (lines {', '.join(map(str, sorted(lines)))})")
            loaded = _again(loaded, text)
    return loaded, said


def _again(loaded: LoadedPlan, text: str) -> LoadedPlan:
    return replace(load(loaded.path, text), planning=loaded.planning)


def _with_place(loaded: LoadedPlan, move: StationMove) -> str | None:
    """The text with a station's translation_mm replaced, or None if it is not written as a list on one line."""
    assert move.place is not None
    index = next(i for i, s in enumerate(loaded.plan.stations) if str(s.id) == move.station)
    number = loaded.lines.get(("stations", index, "pose_in_base", "translation_mm"))
    if number is None:
        return None
    lines = loaded.text.splitlines()
    value = f"translation_mm: [{', '.join(f'{v:.0f}' for v in move.place)}]"
    lines[number - 1], count = re.subn(r"translation_mm:\s*\[[^\]]*\]", value, lines[number - 1])
    return "\n".join(lines) + "\n" if count == 1 else None


def without_lines(loaded: LoadedPlan, numbers: set[int]) -> str | None:
    """The text without the views that stand on these lines, one a line, or None if a step would lose its last one."""
    for index, step in enumerate(loaded.plan.steps):
        if isinstance(step, Look):
            own = [loaded.lines[("steps", index, "views", i)] for i in range(len(step.views))]
            if set(own) <= numbers or len(set(own)) < len(own):
                return None
    lines = loaded.text.splitlines()
    if any(not lines[n - 1].lstrip().startswith("- {") for n in numbers):
        return None
    return "\n".join(line for i, line in enumerate(lines, 1) if i not in numbers) + "\n"
