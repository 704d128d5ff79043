"""The copy of the plan in a run folder, with which a resumed run checks that the plan is still the same."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.recording.datasets.csvfile import write_text

PLAN, FILES = "plan.yaml", "plan.files.json"
SHOWN = 60  # characters of a value


def keep_plan(folder: Path, plan: str, files: Mapping[str, str], cell: str) -> None:
    """Write the plan's text, the texts of the files it names and which cell is driven ('real', or the fake one and its seed)."""
    write_text(folder / PLAN, plan)
    write_text(folder / FILES, json.dumps({"format": "mbcacq-run-plan/1", "cell": cell, "files": dict(files)}, indent=1) + "\n")


def refuse_change(folder: Path, plan: str, files: Mapping[str, str], cell: str) -> None:
    """Raises ConfigError, in one sentence with what changed, unless the folder was recorded with this plan and this kind of cell.

    Comments and layout of the YAML may differ; a value may not.
    """
    try:
        before = (folder / PLAN).read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder} holds no run to resume ({PLAN}: {error.strerror}); give the folder of the interrupted run") from None
    kept = _kept(folder)
    changed = [*_changes("the plan", before, plan)]
    for name, text in kept.get("files", {}).items():
        if name not in files:
            changed.append(f"the plan no longer names {name}")
        else:
            changed += _changes(name, text, files[name])
    if changed:
        more = f" (and {len(changed) - 1} more changes)" if len(changed) > 1 else ""
        raise ConfigError(f"{changed[0]}{more} since {folder} was recorded; take the change back, or start a new run")
    if kept.get("cell", cell) != cell:
        raise ConfigError(
            f"{folder} was recorded with {kept['cell']}, this would go on with {cell}, and the two do not belong into one "
            "recording; give the same options as before, or start a new run"
        )


def _kept(folder: Path) -> dict[str, Any]:
    """Nothing where the file is not there: a run of an earlier version, or one that was killed at once."""
    try:
        found = json.loads((folder / FILES).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise RecordingError(f"{folder / FILES} cannot be read: {error}; is this a run folder?") from None
    return found if isinstance(found, dict) else {}


def _changes(name: str, before: str, now: str) -> Iterator[str]:
    if before != now:
        for where, old, new in _differences(yaml.safe_load(before), yaml.safe_load(now), ""):
            yield f"{name} was changed: {where.lstrip('.')} was {old} and is {new}"


def _differences(old: Any, new: Any, where: str) -> Iterator[tuple[str, str, str]]:
    if isinstance(old, dict) and isinstance(new, dict):
        for key in dict.fromkeys([*old, *new]):
            if key not in old or key not in new:
                yield f"{where}.{key}", _show(old[key]) if key in old else "not there", _show(new[key]) if key in new else "not there"
            else:
                yield from _differences(old[key], new[key], f"{where}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from _differences(a, b, f"{where}[{index}]")
    elif isinstance(old, list) and isinstance(new, list):
        yield where, f"a list of {len(old)}", f"one of {len(new)}"
    elif old != new or type(old) is not type(new) and not (isinstance(old, int | float) and isinstance(new, int | float)):
        yield where, _show(old), _show(new)


def _show(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + "..."
