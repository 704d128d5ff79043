"""Name, start, versions, plan and hashes of a run folder, for the head and the provenance of a report."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from mbcacq.calibration.result_file import FORMAT as RESULT_FORMAT
from mbcacq.diagnosis.findings import FORMAT as DIAGNOSIS_FORMAT
from mbcacq.diagnosis.output.pictures import FORMAT as PICTURES_FORMAT
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.model.json_text import read_json, unsealed
from mbcacq.recording.rrd import layout
from mbcacq.recording.run_folder.journal import read_log, recorded_facts
from mbcacq.report.sources.devices import devices_of

IDENTITY = re.compile(r"(robot|scanner|positioner|sensor \d+): (.+)")  # a device's description; later messages add to it
MAX_LINES = 5
MAX_BYTES = 1 << 20
KEPT = ("plan.yaml", "result.json", "diagnosis.json")
MERGED, MERGED_FORMAT = "merged.json", "mbcacq-merge/1"
WITH_EFFECTS = "with-effects"  # folder of the result of the cell with what its diagnosis found


def read_run_identity(folder: str | Path) -> dict[str, Any]:
    """name, started, versions, plan_yaml and plan_path of a run folder, as far as it has them; nothing for an observation set or a .rrd."""
    folder = Path(folder)
    info: dict[str, Any] = {}
    try:
        with (folder / "journal.jsonl").open(encoding="utf-8") as lines:
            for _, line in zip(range(MAX_LINES), lines, strict=False):
                entry = json.loads(line)
                if entry.get("event") == "run_started":
                    info |= {key: entry[key] for key in ("name", "started", "versions") if key in entry}
                    break
    except (OSError, ValueError, AttributeError):
        pass
    try:
        info["plan_yaml"] = (folder / "plan.yaml").read_bytes()[:MAX_BYTES].decode("utf-8", "replace")
        info["plan_path"] = str(json.loads((folder / "plan.files.json").read_text(encoding="utf-8"))["path"])
    except (OSError, ValueError, LookupError, TypeError):
        pass
    return info


def read_run_info(folder: str | Path) -> dict[str, Any]:
    """``read_run_identity`` with devices, diagnosis and the result of the cell with its effects (where these were made) and hashes: all
    that a whole report needs besides the result.
    """
    folder = Path(folder)
    info = read_run_identity(folder) | {"folder": str(folder), "hashes": hashes(folder)}
    info["identity"] = identities(folder) | {f"{name}, at the first pose": text for name, text in recorded_facts(folder).items()}
    if (devices := devices_of(folder)) is not None:
        info["devices"] = devices
    info |= read_kept_findings(folder)
    if "diagnosis" in info:
        info["pictures"] = _kept(folder / "diagnosis-pictures.json", "mbcacq diagnose", PICTURES_FORMAT)
    return info


def read_kept_findings(folder: Path) -> dict[str, Any]:
    """'diagnosis', 'merged' (a part) and 'with_effects' (the result of the cell with its effects), where the folder of a run keeps them.

    Raises RecordingError if one cannot be read, ConfigError if it is damaged or a newer version wrote it.
    """
    found = {}
    if (diagnosis := _kept(folder / "diagnosis.json", "mbcacq diagnose", DIAGNOSIS_FORMAT)) is not None:
        found["diagnosis"] = diagnosis
    if (merged := _kept(folder / MERGED, "mbcacq merge", MERGED_FORMAT)) is not None:
        found["merged"] = merged
    better = folder / WITH_EFFECTS / "result.json"
    if (result := _kept(better, "mbcacq diagnose --calibrate", RESULT_FORMAT)) is not None:
        found["with_effects"] = unsealed(result, better)
    return found


def identities(folder: Path) -> dict[str, str]:
    """Model, serial number and firmware that each device gave at the start, from the log."""
    found: dict[str, str] = {}
    for entry in read_log(folder):
        match = IDENTITY.fullmatch(str(entry.get("text", "")))
        if match and entry.get("level") == "info":
            found.setdefault(match[1], match[2])
    return {f"{role}, as it says of itself": text for role, text in found.items()}


def hashes(folder: Path) -> list[tuple[str, str, str]]:
    """(file, bytes, SHA-256) of the recordings and of what was made from them."""
    out = []
    for path in [*layout.parts(folder), *(folder / name for name in KEPT)]:
        try:
            with path.open("rb") as file:
                out.append((path.name, f"{path.stat().st_size:,}".replace(",", " "), hashlib.file_digest(file, "sha256").hexdigest()))
        except OSError:
            continue
    return out


def _kept(path: Path, program: str, known: str) -> dict[str, Any] | None:
    """What a command kept in the folder; None if it kept nothing. program: that command; known: format that this version reads.

    Raises RecordingError if the file cannot be read, ConfigError if it is damaged or a newer version wrote it.
    """
    try:
        text = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):  # a run is a folder; a recording or a set is not
        return None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}; make it readable, or remove it") from error
    content = read_json(text, str(path), f"write it anew with {program}, or remove it")
    if not isinstance(content, dict):
        raise ConfigError(f"{path} is damaged (it holds no object); write it anew with {program}, or remove it")
    name, _, version = str(content.get("format", known)).partition("/")
    if name == known.partition("/")[0] and version.isdecimal() and int(version[:9]) > int(known.partition("/")[2]):
        raise ConfigError(f"{path} is of format '{name}/{version[:9]}', which a newer mbcacq wrote; update mbcacq, or write it anew")
    return content
