"""What a run folder says about itself, for the report's head and provenance."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

MAX_LINES = 5
MAX_BYTES = 1 << 20


def about_run(folder: str | Path) -> dict[str, Any]:
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
