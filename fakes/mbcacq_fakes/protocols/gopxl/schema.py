"""JSON Schemas of the fake sensor's resources, made of their values: types everywhere, limits where the sensor has some."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string", bytes: "string", list: "array"}
LIMITS: Mapping[str, Mapping[str, Any]] = {
    "runState": {"readOnly": True, "enum": [0, 1, 2], "enumText": ["Ready", "Running", "Conflict"]},
    "serialNumber": {"readOnly": True},
    "singleExposure": {"minimum": 100.0, "maximum": 100_000.0, "units": "us"},
    "exposureMode": {"enum": [0, 1, 2], "enumText": ["Single", "Multiple", "Dynamic"]},
    "source": {"enum": [0, 1, 2, 3], "enumText": ["Time", "Encoder", "External Input", "Software"]},
}


def schema_of(value: Any, name: str = "") -> dict[str, Any]:
    """The schema of one value and of all in it, links and embedded resources left out."""
    if isinstance(value, Mapping):
        inside = {key: schema_of(v, key) for key, v in value.items() if not key.startswith("_")}
        return {"type": "object", "properties": inside}
    return {"type": _TYPES[type(value)], "title": name, **LIMITS.get(name, {})}
