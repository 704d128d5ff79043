"""Name, start, versions, plan and hashes of a run folder, for the head and the provenance of a report."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from mbcacq.recording.rrd import layout
from mbcacq.recording.run_folder.journal import read_log

IDENTITY = re.compile(r"(robot|scanner|positioner|sensor \d+): (.+)")  # a device's description; later messages add to it
MAX_LINES = 5
MAX_BYTES = 1 << 20
KEPT = ("plan.yaml", "result.json", "diagnosis.json")
WITH_EFFECTS = "with-effects"  # folder of the result of the cell with what its diagnosis found


def read_run_identity(folder: str | Path) -> dict[str, Any]:
    """name, started, versions and plan_yaml of a run folder, as far as it has them; nothing for an observation set or a .rrd."""
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
    except OSError:
        pass
    return info


def read_run_info(folder: str | Path) -> dict[str, Any]:
    """``read_run_identity`` with devices, diagnosis and the result of the cell with its effects (where these were made) and hashes: all
    that a whole report needs besides the result.
    """
    from mbcacq.report.sources.devices import devices_of

    folder = Path(folder)
    info = read_run_identity(folder) | {"folder": str(folder), "hashes": hashes(folder)}
    info["identity"] = identities(folder)
    if (devices := devices_of(folder)) is not None:
        info["devices"] = devices
    diagnosis, pictures = _json(folder / "diagnosis.json"), _json(folder / "diagnosis-pictures.json")
    if diagnosis is not None:
        info |= {"diagnosis": diagnosis, "pictures": pictures}
    if (better := _json(folder / WITH_EFFECTS / "result.json")) is not None:
        info["with_effects"] = better
    return info


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


def _json(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None
