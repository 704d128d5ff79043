"""A plan's YAML with other views in it, everything else left as its author wrote it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mbcacq.design.candidate_views import CandidateView
from mbcacq.model import yaml12
from mbcacq.plan import LoadedPlan
from mbcacq.plan.schema import PartView, View

NAME = "designed"
PURPOSE = {"position": "for what they determine of the arm", "part": "for the surface that they show"}


Chosen = dict[tuple[str, int | None], list[View]]


def by_station(views: Iterable[CandidateView], stations: Sequence[str]) -> Chosen:
    """Views station by station, ball by ball, one wrist branch after the other, around the artefact."""
    chosen: Chosen = {}
    for one in sorted(views, key=lambda v: (stations.index(v.station), v.aim or 0, v.view.wrist, v.view.azimuth_deg)):
        chosen.setdefault((one.station, one.aim), []).append(one.view)
    return chosen


def seen_from(folder: Path, path: Path) -> str:
    """The name of a file in a plan of a folder: relative to it, if it is on the same drive."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return str(path.resolve())


def with_views(loaded: LoadedPlan, chosen: Chosen) -> str:
    """The text of the plan with its 'position' steps replaced by one step a station (and ball), where the first of them stood, or first."""
    named = {key: f"{NAME} {key[0]}" for key in chosen}
    return with_position_steps(loaded, [position_step(named[key], *key, views) for key, views in chosen.items()])


def with_position_steps(loaded: LoadedPlan, steps: list[dict[str, Any]]) -> str:
    """The text of the plan with these steps in the place of its 'position' steps, where the first of them stood, or first."""
    return with_steps(loaded, steps, "position")


def with_steps(loaded: LoadedPlan, steps: list[dict[str, Any]], phase: str) -> str:
    """The text of the plan with these steps in the place of those of a phase, where the first of them stood, or first."""
    text = _spliced(loaded, steps, phase)
    expected = _replaced(loaded, steps, phase)
    if text is not None and yaml12.load(text) == expected:
        return text
    # Steps not written one below the other: the meaning is kept, the comments are not.
    return yaml12.dump(expected, allow_unicode=True, width=140)


def position_step(name: str, station: str, aim: int | None, views: list[View]) -> dict[str, Any]:
    """A step of views at a station, of one ball or of all (None)."""
    name, balls = (name, None) if aim is None else (f"{name} ball {aim}", [aim])
    return look_step(name, "position", [_id(station)], [view_mapping(v) for v in views], balls)


def look_step(
    name: str, phase: str, stations: Sequence[str | int], views: list[dict[str, Any]], balls: list[int] | str | None = None
) -> dict[str, Any]:
    """A step ``do: look``, its keys in the order in which a plan has them."""
    which = {} if balls is None else {"balls": balls}
    return {"name": name, "phase": phase, "do": "look", "stations": list(stations), **which, "views": views}


def _id(station: str) -> str | int:
    return int(station) if station.isdecimal() and str(int(station)) == station else station


def view_mapping(view: View) -> dict[str, Any]:
    """A view as it stands in a plan."""
    angles = {"tilt_deg": view.tilt_deg, "azimuth_deg": view.azimuth_deg, "roll_deg": view.roll_deg}
    content: dict[str, Any] = {k: int(v) if float(v).is_integer() else v for k, v in angles.items()}
    if isinstance(view, PartView) and view.at_mm is not None:
        content = {"at_mm": [int(x) if float(x).is_integer() else x for x in view.at_mm], **content}
    if any(view.shift_mm):
        content["shift_mm"] = [int(x) if float(x).is_integer() else x for x in view.shift_mm]
    if view.wrist != "any":
        content["wrist"] = view.wrist
    return content


def _replaced(loaded: LoadedPlan, steps: list[dict[str, Any]], phase: str) -> dict[str, Any]:
    data = yaml12.load(loaded.text)
    old = [i for i, s in enumerate(data["steps"]) if s.get("phase", "part") == phase]
    at = old[0] if old else 0
    left = [s for i, s in enumerate(data["steps"]) if i not in old]
    data["steps"] = left[:at] + steps + left[at:]
    return data


def _spliced(loaded: LoadedPlan, steps: list[dict[str, Any]], phase: str) -> str | None:
    """The text with lines replaced and everything else kept, or None where steps share lines."""
    lines, plan = loaded.text.splitlines(), loaded.plan
    starts = [loaded.lines["steps", i] - 1 for i in range(len(plan.steps))]
    if len(set(starts)) < len(starts) or not all(lines[s].lstrip().startswith("- ") for s in starts):
        return None
    indent = lines[starts[0]][: len(lines[starts[0]]) - len(lines[starts[0]].lstrip())]
    after = [i for i in range(starts[-1] + 1, len(lines)) if lines[i] and not lines[i].startswith((indent + " ", indent + "#"))]
    bounds = [*starts, after[0] if after else len(lines)]
    old = [i for i, s in enumerate(plan.steps) if s.phase == phase]
    new = [f"{indent}# Chosen by `mbcacq plan design`, of many views that can be taken, {PURPOSE[phase]}."]
    new += [indent + line if line else line for step in steps for line in [*step_lines(step), ""]]
    out = lines[: starts[0]]
    for i in range(len(plan.steps)):
        if i in old:
            # A comment right above a step is about that step, and goes with it.
            while out and out[-1].lstrip().startswith("#"):
                out.pop()
        if i == (old[0] if old else 0):
            out += new
        if i not in old:
            out += lines[bounds[i] : bounds[i + 1]]
        else:
            kept = lines[bounds[i] : bounds[i + 1]]
            out += kept[len(kept) - _trailing_comment(kept) :]
    return "\n".join([*out, *lines[bounds[-1] :]]) + "\n"


def _trailing_comment(lines: list[str]) -> int:
    """How many lines at the end of a step are the comment of the next one."""
    count = 0
    while count < len(lines) and lines[-1 - count].lstrip().startswith("#"):
        count += 1
    return count


def step_lines(step: dict[str, Any]) -> list[str]:
    """A step ``do: look`` as lines of a plan, a view a line."""
    head = [f"- name: {flow(step['name'])}", f"  phase: {step['phase']}", f"  do: {step['do']}"]
    head += [f"  {key}: {flow(step[key])}" for key in ("stations", "balls", "exposures") if key in step]
    return [*head, "  views:", *(f"    - {flow(view)}" for view in step["views"])]


def flow(value: Any) -> str:
    """A value on one line of YAML."""
    text = yaml12.dump(value, default_flow_style=True, width=1000, allow_unicode=True)
    return text.strip().removesuffix("...").strip()
