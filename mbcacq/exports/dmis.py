"""Spheres in DMIS output (ISO 22093): ``FA(label)=FEAT/SPHERE,OUTER,CART,x,y,z,diameter``; '$' continues a line, '$$' begins a comment."""

from __future__ import annotations

import re
from typing import Any

from mbcacq.errors import ConfigError

TO_MM = {"MM": 1.0, "CM": 10.0, "M": 1e3, "METER": 1e3, "METRE": 1e3, "INCH": 25.4, "IN": 25.4, "FEET": 304.8, "FOOT": 304.8, "FT": 304.8}
_FEATURE = re.compile(r"^FA\(\s*(?P<label>[^)]*?)\s*\)\s*=\s*FEAT\s*/\s*SPHERE\s*,(?P<rest>.*)$", re.IGNORECASE)
_UNITS = re.compile(r"^UNITS\s*/\s*(\w+)", re.IGNORECASE)


def spheres(text: str, name: str) -> list[dict[str, Any]]:
    """Measured spheres (FA, not the nominal F) as label, x, y, z, d in mm. Raises ConfigError with ``name`` and line."""
    scale, out = 1.0, []
    for number, line in _joined(text):
        if units := _UNITS.match(line):
            if units.group(1).upper() not in TO_MM:
                raise ConfigError(f"{name}:{number}: the unit '{units.group(1)}' is not known; DMIS has MM, CM, METER, INCH and FEET")
            scale = TO_MM[units.group(1).upper()]
        feature = _FEATURE.match(line)
        if feature is None:
            continue
        parts = [p.strip() for p in feature.group("rest").split(",")]
        if len(parts) < 6 or parts[0].upper() not in ("OUTER", "INNER") or parts[1].upper() != "CART":
            raise ConfigError(f"{name}:{number}: a sphere must read FEAT/SPHERE,OUTER,CART,x,y,z,diameter, not '{line}'")
        try:
            x, y, z, d = (scale * float(p) for p in parts[2:6])
        except ValueError:
            raise ConfigError(f"{name}:{number}: the sphere '{feature.group('label')}' has a value that is no number: '{line}'") from None
        if not d > 0:
            raise ConfigError(f"{name}:{number}: the diameter {d:g} of sphere '{feature.group('label')}' is not positive")
        out.append({"label": feature.group("label"), "x": x, "y": y, "z": z, "d": d})
    return out


def _joined(text: str) -> list[tuple[int, str]]:
    """(line number, statement) with continued lines put together and comments left out."""
    out: list[tuple[int, str]] = []
    carried, start = "", 0
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if line.startswith("$$"):
            continue
        start = start if carried else number
        carried += line
        if carried.endswith("$"):
            carried = carried[:-1].rstrip()
            continue
        if carried:
            out.append((start, carried))
        carried = ""
    if carried:
        out.append((start, carried))
    return out
