"""A plan that grows: the steps of another plan of the same cell after its own, so that a recording of it can be extended."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mbcacq.errors import ConfigError
from mbcacq.model import yaml12
from mbcacq.plan.loader import load
from mbcacq.plan.planned import LoadedPlan

OWN = ("name", "steps", "accept")  # keys in which an extension may differ from the plan that it extends


def grown(loaded: LoadedPlan, further: LoadedPlan, poses: int) -> LoadedPlan:
    """The plan with the steps of another one after its own. poses: number of poses of the plan as it was first run.

    Raises ConfigError, in one sentence with what differs, where the other plan is not of the same cell.
    """
    refuse_another_cell(loaded, further)
    steps = yaml12.load(further.text)["steps"]
    if any(step["phase"] == "verification" for step in steps):
        raise ConfigError(
            f"{further.path}: verification poses judge a calibration and extend none; leave that step out, or run the plan by itself"
        )
    steps = _with_own_names(steps, {step.name for step in loaded.plan.steps})
    return replace(load(loaded.path, with_steps(loaded, steps)), grown_from=loaded.grown_from or poses)


def _with_own_names(steps: list[dict[str, Any]], taken: set[str]) -> list[dict[str, Any]]:
    """The steps, those whose name is taken by another number."""
    out, taken = [], set(taken)
    for step in steps:
        name, number = step["name"], 2
        while name in taken:
            name, number = f"{step['name']} ({number})", number + 1
        taken.add(name)
        out.append({**step, "name": name})
    return out


def with_steps(loaded: LoadedPlan, steps: list[dict[str, Any]]) -> str:
    """The text of the plan with further steps after its own, everything else left as its author wrote it."""
    data = yaml12.load(loaded.text)
    data["steps"] = [*data["steps"], *steps]
    text = _spliced(loaded, steps)
    return (
        text
        if text is not None and yaml12.load(text) == data
        else yaml12.dump(data, allow_unicode=True, width=140, default_flow_style=None)
    )


def _spliced(loaded: LoadedPlan, steps: list[dict[str, Any]]) -> str | None:
    """The text with lines put after the last step, or None if that one does not begin a line."""
    lines = loaded.text.splitlines()
    last = loaded.lines["steps", len(loaded.plan.steps) - 1] - 1
    if not lines[last].lstrip().startswith("- "):
        return None
    indent = lines[last][: len(lines[last]) - len(lines[last].lstrip())]
    after = [i for i in range(last + 1, len(lines)) if lines[i] and not lines[i].startswith((indent + " ", indent + "#", "#"))]
    end = after[0] if after else len(lines)
    while end > last + 1 and (not lines[end - 1] or lines[end - 1].startswith("#")):
        end -= 1  # what is written above the next key is about that key
    added = yaml12.dump(steps, allow_unicode=True, width=140, default_flow_style=None).splitlines()
    return "\n".join([*lines[:end], *(indent + line for line in added), *lines[end:]]) + "\n"


def refuse_another_cell(loaded: LoadedPlan, further: LoadedPlan) -> None:
    """Raises ConfigError if two plans do not describe the same cell: arm, scanner, artefacts, stations, what is in the way."""
    one, other = (_without_files(yaml12.load(plan.text)) for plan in (loaded, further))
    for key in dict.fromkeys([*one, *other]):
        if key not in OWN and one.get(key) != other.get(key):
            raise ConfigError(
                f"{further.path}: '{key}' is not as in the plan of the recording ({loaded.path}), which grows in its own cell only; "
                "take the difference back, or run this plan by itself"
            )
    if list(loaded.files.values()) != list(further.files.values()):
        names = [a for a, b in zip(further.files, loaded.files, strict=False) if further.files[a] != loaded.files[b]]
        named = names[0] if names else "an artefact"
        raise ConfigError(f"{further.path}: {named} is not what it was when the recording began; take the change back, or start a new run")


def _without_files(data: dict[str, Any]) -> dict[str, Any]:
    """The content without names of files, which are relative to the plan; their texts are compared."""
    robot = {key: value for key, value in data["robot"].items() if key not in ("model", "urdf")}
    return {key: value for key, value in {**data, "robot": robot}.items() if key != "artefacts"}
