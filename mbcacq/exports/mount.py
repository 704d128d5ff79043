"""Whether a result knows what stands on the flange: which it is, and whether its frame was determined."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from mbcacq.errors import ConfigError
from mbcacq.model.cell import TARGET_IN_BASE

ON_REQUEST = "held on request"
_MOUNT = re.compile(r"hand_eye(\[\d+\])?\.(x|y|z|rx|ry|rz)")


class UndeterminedMount(ConfigError):
    """A format needs the frame on the flange, and the measurements did not determine all of it."""


def is_target(result: Mapping[str, Any]) -> bool:
    """Whether a target is on the flange, and the instrument stands in the base (a laser tracker, a fixed camera)."""
    return result.get("measurement") == TARGET_IN_BASE


def undetermined(result: Mapping[str, Any]) -> str:
    """Which part of the frame on the flange was not determined, and why; '' if all of it was, or the user held it."""
    held = {m.group(2): why for name, why in (result.get("held") or {}).items() if (m := _MOUNT.fullmatch(name)) and why != ON_REQUEST}
    if not held:
        return ""
    turned, moved = any(c.startswith("r") for c in held), any(not c.startswith("r") for c in held)
    part = " and ".join([*(["position"] if moved else []), *(["orientation"] if turned else [])])
    what = "target" if is_target(result) else "scanner"
    return f"the {part} of the {what} on the flange was not determined ({next(iter(held.values()))})"


def remark(result: Mapping[str, Any]) -> list[str]:
    """One sentence on what no file says of the flange, or none."""
    why = undetermined(result)
    return [f"{why}: its frame is in no file for controllers, ROS or simulators"] if why else []
