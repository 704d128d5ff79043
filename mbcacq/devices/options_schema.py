"""The options of the installed drivers as JSON Schema, for editors: a driver class names its pydantic model, or dataclass, of them."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from pydantic import TypeAdapter
from pydantic.errors import PydanticUserError

SECTIONS = {"robots": "robot", "scanners": "scanner", "positioners": "positioner", "sensors": "sensors"}  # of a plan, by kind


def driver_options(kind: str) -> dict[str, dict[str, Any]]:
    """JSON Schema of the options of each installed driver of a kind that names them by ``options_model``, by the driver's name.

    A plan need not have the options that the program itself hands over from the robot file.
    """
    found = {}
    for point in sorted(entry_points(group=f"mbcacq.{kind}"), key=lambda point: point.name):
        try:
            model = getattr(point.load(), "options_model", None)
            if model is not None:
                schema = TypeAdapter(model).json_schema(ref_template=f"#/$defs/{kind}.{point.name}/$defs/{{model}}")
                found[point.name] = {**schema, "additionalProperties": False, "required": []}
        except (Exception, PydanticUserError):  # a package from outside may raise anything; the schema is then without its options
            continue
    return found


def with_driver_options(schema: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of a plan with the names of the installed drivers, and for each of them its own options."""
    definitions = dict(schema.get("$defs", {}))
    properties = dict(schema["properties"])
    for kind, section in SECTIONS.items():
        options = driver_options(kind)
        definitions |= {f"{kind}.{name}": one for name, one in options.items()}
        rules = [
            {
                "if": {"properties": {"driver": {"const": name}}, "required": ["driver"]},
                "then": {"properties": {"options": {"$ref": f"#/$defs/{kind}.{name}"}}},
            }
            for name in options
        ]
        names = [point.name for point in entry_points(group=f"mbcacq.{kind}")]
        rules.append({"properties": {"driver": {"enum": sorted({*names, *(name.replace("_", "-") for name in names)})}}})
        properties[section] = _with_rules(properties[section], rules)
    return {**schema, "$defs": definitions, "properties": properties}


def _with_rules(section: dict[str, Any], rules: list[dict[str, Any]]) -> dict[str, Any]:
    if section.get("type") == "array":
        return {**section, "items": {"allOf": [section["items"], *rules]}}
    return {**{key: value for key, value in section.items() if key != "$ref"}, "allOf": [{"$ref": section["$ref"]}, *rules]}
