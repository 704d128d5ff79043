"""The copy of the plan in a run folder, with which a resumed run checks that the plan is the same. The recordings hold another."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.files.atomic_write import write_file
from mbcacq.model import yaml12
from mbcacq.model.yaml_source import parse
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.checksums import digest_of_file, note_whole, read_stretches

PLAN, FILES = "plan.yaml", "plan.files.json"
FORMAT = "mbcacq-run-plan/1"
COPY_OF = {PLAN: layout.PLAN, FILES: layout.PLAN_FILES}
SHOWN = 60  # characters of a value


@dataclass(frozen=True, kw_only=True)
class KeptPlan:
    """The plan that a run folder holds.

    Attributes
    ----------
    plan : str or None
        Its YAML.
    files : Mapping[str, str] or None
        Name -> text of the files it names.
    cell : str or None
        The cell that was driven. Fields are None if neither the folder nor its recordings state them.
    path : str or None
        Where the plan was read from, in runs of today.
    corrected : Mapping[str, Any] or None
        Corrected of a run that a calibrated arm steers, its targets.
    grown_from : int or None
        Number of poses that the plan had before others were added.
    repairs : tuple[str, ...]
        One sentence for each file that had to be restored or is lost.
    """

    plan: str | None
    files: Mapping[str, str] | None
    cell: str | None
    repairs: tuple[str, ...] = field(default=())
    path: str | None = None
    corrected: Mapping[str, Any] | None = None
    grown_from: int | None = None


def plan_files_text(  # noqa: PLR0913 -- each is one field of the file
    files: Mapping[str, str],
    cell: str,
    kind: str = "run",
    path: Path | None = None,
    corrected: Mapping[str, Any] | None = None,
    grown_from: int | None = None,
) -> str:
    """plan.files.json: the texts of the files that the plan names, and which cell is driven ('real', or the fake one and its seed).

    kind: what is recorded, see ``RunKind``. path: of the plan, with which a resumed run needs not be given it again. corrected: nominal and
    corrected joint angles, where a calibrated arm steers the run. grown_from: see ``LoadedPlan``; the plan is then the one that the folder
    keeps."""
    where = {} if path is None else {"path": str(path.absolute())}
    steered = {} if corrected is None else {"corrected": corrected}
    grown = {} if grown_from is None else {"grown_from": grown_from}
    return json.dumps({"format": FORMAT, "kind": kind, "cell": cell, **where, **steered, **grown, "files": dict(files)}, indent=1) + "\n"


def plan_of_run(folder: Path) -> Path:
    """The plan that a run folder was recorded with. Raises ConfigError if the folder does not say, or the plan is gone."""
    try:
        kept = json.loads((folder / FILES).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{folder} holds no run to resume; give the folder of the interrupted run") from None
    except (OSError, ValueError):
        kept = {}
    path = kept.get("path") if isinstance(kept, dict) else None
    if not isinstance(path, str):
        raise ConfigError(f"{folder} does not say which plan it was recorded with; give that: mbcacq run PLAN --resume {folder}")
    if not Path(path).is_file():
        raise ConfigError(f"the plan {path} of {folder} is gone; give where it is now: mbcacq run PLAN --resume {folder}")
    return Path(path)


def keep_plan(folder: Path, plan: str, plan_files: str) -> None:
    """Write the plan's text and ``plan_files_text``, with their checksums. They are on the disk when the call returns."""
    for name, text in ((PLAN, plan), (FILES, plan_files)):
        _keep(folder, name, text)


def _keep(folder: Path, name: str, text: str) -> None:
    write_file(folder / name, data := text.encode("utf-8"))
    note_whole(folder, name, data)


def read_kept_plan(folder: Path) -> KeptPlan:
    """What a run folder was recorded with. A file that is missing or damaged is restored from the recordings, which must be readable.

    Raises ConfigError if the folder holds no run.
    """
    parts = layout.parts(folder)
    if not (parts or (folder / PLAN).exists() or (folder / layout.JOURNAL_FILE).exists()):
        raise ConfigError(f"{folder} holds no run to resume; give the folder of the interrupted run")
    found, repairs = {}, []
    for name in (PLAN, FILES):
        what = fault_of(folder, name)
        if not what:
            found[name] = (folder / name).read_text(encoding="utf-8")
            continue
        copy = _recorded(parts, name)
        if copy is not None:
            _keep(folder, name, copy)
            found[name] = copy
            repairs.append(f"{folder / name} {what}; it was restored from {layout.RUN_FILE}")
        elif parts:
            repairs.append(f"{folder / name} {what}, and no recording holds a copy; it is taken to be as in this run")
    kept = json.loads(found[FILES]) if FILES in found else {}
    read = {key: kept.get(key) for key in ("path", "corrected", "grown_from")}
    return KeptPlan(plan=found.get(PLAN), files=kept.get("files"), cell=kept.get("cell"), repairs=tuple(repairs), **read)


def fault_of(folder: Path, name: str) -> str:
    """What is wrong with plan.yaml or plan.files.json, as a predicate ('is missing'); '' for an intact one."""
    path = folder / name
    try:
        data = path.read_bytes()
        text = data.decode("utf-8")
        content = parse(text, path).data if name == PLAN else json.loads(text)
        noted = read_stretches(folder)[0].get(name)
        if noted and digest_of_file(path, 0, len(data))[0] != noted[-1].sha256:
            return "is damaged (it is not as it was written)"
    except FileNotFoundError:
        return "is missing"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    except (ValueError, RecursionError):
        return "is damaged (it is empty or no longer text of its format)"
    whole = isinstance(content, dict) and (name == PLAN or _is_plan_files(content))
    return "" if whole else "is damaged (it is empty or no longer text of its format)"


def _is_plan_files(content: dict[str, Any]) -> bool:
    files = content.get("files", {})
    whole = isinstance(files, dict) and all(isinstance(text, str) for text in files.values())
    return whole and isinstance(content.get("cell", ""), str) and isinstance(content.get("corrected", {}), dict)


def _recorded(parts: list[Path], name: str) -> str | None:
    """The copy of a file in the newest recording that has an intact one."""
    from mbcacq.recording.rrd.reader import Recording

    for path in reversed(parts):
        try:
            return Recording(path).text(COPY_OF[name])
        except (RecordingError, ConfigError):
            continue
    return None


def refuse_change(folder: Path, kept: KeptPlan, plan: str, files: Mapping[str, str], cell: str) -> None:
    """Raises ConfigError, in one sentence with what changed, unless the folder was recorded with this plan and this kind of cell.

    Comments and layout of the YAML may differ; a value may not.
    """
    changed = [] if kept.plan is None else [*_changes("the plan", kept.plan, plan)]
    for name, text in (kept.files or {}).items():
        if name not in files:
            changed.append(f"the plan no longer names {name}")
        else:
            changed += _changes(name, text, files[name])
    if changed:
        more = f" (and {len(changed) - 1} more changes)" if len(changed) > 1 else ""
        raise ConfigError(f"{changed[0]}{more} since {folder} was recorded; take the change back, or start a new run")
    if kept.cell is not None and kept.cell != cell:
        raise ConfigError(
            f"{folder} was recorded with {kept.cell}, this would go on with {cell}, and the two do not belong into one "
            "recording; give the same options as before, or start a new run"
        )


def _changes(name: str, before: str, now: str) -> Iterator[str]:
    if before != now:
        for where, old, new in _differences(yaml12.load(before), yaml12.load(now), ""):
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
