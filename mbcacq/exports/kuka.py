"""KUKA ``$config.dat``: the scanner frame as TOOL_DATA[n], as a snippet and as a unified diff. A controller's file is never edited.

mm and degrees; A about Z, B about Y, C about X (R = Rz(A) Ry(B) Rx(C)); Latin-1 with CRLF line ends.
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import bytes_of
from mbcacq.geometry import se3
from mbcacq.quantities import in_degrees

TOOLS = range(1, 129)
NAME_LENGTH = 24
MAX_BYTES = 16 << 20


def tool_data(T_flange_scanner: np.ndarray, number: int, name: str = "mbcacq scanner") -> str:
    """The two assignments for tool ``number``, CRLF line ends. Raises ConfigError for a number or name the controller does not take."""
    return "".join(f"{line}\r\n" for line in _lines(T_flange_scanner, number, name))


def config_diff(path: str | Path, T_flange_scanner: np.ndarray, number: int, name: str = "mbcacq scanner") -> str:
    """Unified diff that puts the tool into a ``$config.dat``; empty if it is there already. Raises ConfigError naming the file."""
    path = Path(path)
    cure = "give the controller's $config.dat"
    raw = bytes_of(path, MAX_BYTES, cure, cure)
    old = raw.decode("latin-1").splitlines(keepends=True)
    new = list(old)
    end = "\r\n" if any(line.endswith("\r\n") for line in old) else "\n"
    missing = []
    for wanted in _lines(T_flange_scanner, number, name):
        left = wanted.split("=", 1)[0]
        at = next((i for i, line in enumerate(new) if _same_target(line, left)), None)
        if at is None:
            missing.append(wanted + end)
        else:
            new[at] = wanted + new[at][len(new[at].rstrip("\r\n")) :]
    if missing:
        stop = next((i for i, line in enumerate(new) if line.strip().upper().startswith("ENDDAT")), None)
        if stop is None:
            raise ConfigError(f"{path}: has neither this tool nor ENDDAT, so it is no $config.dat; give the controller's own file")
        new[stop:stop] = missing
    return "".join(difflib.unified_diff(old, new, f"a/{path.name}", f"b/{path.name}", n=2))


def _lines(T: np.ndarray, number: int, name: str) -> list[str]:
    if number not in TOOLS:
        raise ConfigError(f"tool number {number} does not exist on a KUKA controller; give one of {TOOLS.start} to {TOOLS.stop - 1}")
    if not name.isascii() or not name.isprintable() or '"' in name or not 0 < len(name) <= NAME_LENGTH:
        raise ConfigError(f"tool name {name!r} must be 1 to {NAME_LENGTH} plain characters without quotes")
    xyz, abc = se3.to_abc(np.asarray(T, dtype=float))
    value = zip("XYZABC", (*xyz, *in_degrees(abc)), strict=True)
    frame = ",".join(f"{axis} {v + 0.0:.{5 if axis in 'XYZ' else 6}f}" for axis, v in value)
    return [f"TOOL_DATA[{number}]={{{frame}}}", f'TOOL_NAME[{number},]="{name}"']


def _same_target(line: str, left: str) -> bool:
    squeezed = re.sub(r"\s+", "", line).upper()
    return squeezed.startswith(left.upper() + "=")
