"""What the devices of a run said, as one file that can be sent: identities, versions, settings, the plan, what went wrong."""

from __future__ import annotations

import json
import platform
import re
from pathlib import Path
from typing import Any

from mbcacq.devices.addresses import ADDRESS_KEY
from mbcacq.recording.run_folder.journal import read_journal, read_log
from mbcacq.recording.run_folder.run_plan import read_kept_plan
from mbcacq.version import __version__

FORMAT = "mbcacq-evidence/1"
REMOVED = "(removed)"
_ADDRESS = re.compile(r"(?<![\w.])(?:\d{1,3}\.){3}\d{1,3}(?![\w.])|(?<![\w:])(?:[0-9a-fA-F]{1,4}:){3,7}[0-9a-fA-F:]{1,39}(?![\w:])")
_SERIAL = re.compile(r"serial", re.IGNORECASE)
_OPTION = re.compile(r"(?P<key>[\w-]+)(?P<between>\s*:\s*)(?P<value>\"[^\"\n]*\"|'[^'\n]*'|[^\s,{}\[\]#]+)")


def evidence(run: Path, anonymous: bool = False) -> dict[str, Any]:
    """What a run folder holds of it: devices as they described themselves, parts of the run, poses, gaps, the log, the plan, versions.

    anonymous: addresses, host names, users and serial numbers are replaced by ``(removed)`` wherever they stand.
    Raises RecordingError if the folder holds no run.
    """
    journal = read_journal(run)
    entries = [entry for entry in journal if entry.get("event") != "pose_done"]
    found = {
        "format": FORMAT,
        "mbcacq": __version__,
        "system": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "devices": [entry for entry in entries if entry.get("event") == "device"],
        "events": [entry for entry in entries if entry.get("event") != "device"],
        "poses": [entry for entry in journal if entry.get("event") == "pose_done"],
        "log": read_log(run),
        "plan": read_kept_plan(run).plan or "",
    }
    if not anonymous:
        return found
    secret = {str(entry.get("serial", "")) for entry in found["devices"]} | _named_places(found["plan"])
    secret |= {str(v) for entry in found["devices"] for k, v in entry.get("settings", {}).items() if _SERIAL.search(k)}
    text = json.dumps(found, ensure_ascii=False)
    for word in sorted(filter(None, secret), key=len, reverse=True):
        text = re.sub(rf"(?<!\w){re.escape(json.dumps(word, ensure_ascii=False)[1:-1])}(?!\w)", REMOVED, text)
    versions = {v for entry in found["events"] for v in entry.get("versions", {}).values()} | {e.get("firmware") for e in found["devices"]}
    return json.loads(_ADDRESS.sub(lambda match: match[0] if match[0] in versions else REMOVED, text))  # a version may look like one


def _named_places(plan_text: str) -> set[str]:
    """Values of options that name a place, a person or a device, as a plan's text gives them; numbers such as ports stay."""
    found = set()
    for line in plan_text.splitlines():
        for match in _OPTION.finditer(line.split(" #")[0]):
            value = match["value"].strip("\"'")
            if (ADDRESS_KEY.search(match["key"]) or match["key"] == "user") and not re.fullmatch(r"[\d.]*|true|false|null", value):
                found.add(value)
    return found
