"""The JSON Schema of a diagnosis, made from the types of its parts: what ``DiagnosisResult.to_dict`` writes, and nothing by hand.

It is kept in the package as the contract with other programs (``mbcacq.diagnosis.schema``), and a test compares the two.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from typing import Any

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode, JsonSchemaValue

from mbcacq.diagnosis.findings import FORMAT
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.workflow.diagnosis_document import BesidePoses

ABOUT = (
    "What mbcacq diagnose says about a recording of poses, and under 'motion' about the motion between them; what it says about a motion "
    "alone is '#/$defs/MotionDiagnosis'. Lengths mm, angles rad unless a name says deg; a number that is not finite is null."
)


class _AsWritten(GenerateJsonSchema):
    """Every field of a dataclass is written, also where it has a default, but for those that its type says are left out or came later."""

    _optional: AbstractSet[str] = frozenset()  # of the dataclass that is being described

    def dataclass_schema(self, schema: Any) -> JsonSchemaValue:
        kind, around = schema["cls"], self._optional
        self._optional = {*getattr(kind, "left_out", ()), *getattr(kind, "later", ())}
        try:
            return super().dataclass_schema(schema)
        finally:
            self._optional = around

    def dataclass_args_schema(self, schema: Any) -> JsonSchemaValue:
        return super().dataclass_args_schema(schema | {"fields": [f for f in schema["fields"] if not f.get("serialization_exclude")]})

    def field_is_required(self, field: Any, total: bool) -> bool:
        if field["type"] == "dataclass-field":
            return field["name"] not in self._optional
        return super().field_is_required(field, total)


def generated_schema() -> dict[str, Any]:
    """The schema (JSON Schema 2020-12) as Python lists and dictionaries."""
    kinds: list[Any] = [Diagnosis, BesidePoses]
    each: list[tuple[str, JsonSchemaMode, TypeAdapter[Any]]] = [(kind.__name__, "validation", TypeAdapter(kind)) for kind in kinds]
    found, shared = TypeAdapter.json_schemas(each, schema_generator=_AsWritten)
    parts = _terse(shared.pop("$defs"))
    schemas = [_terse(found[kind.__name__, "validation"]) for kind in kinds]  # one may be a reference to a part, which is taken out
    of_poses, beside = (parts.pop(one["$ref"].rsplit("/", 1)[-1]) if "$ref" in one else one for one in schemas)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": FORMAT.replace("/", "-"),
        "title": FORMAT,
        "description": ABOUT,
        "$defs": dict(sorted(parts.items())),
        "type": "object",
        "properties": beside["properties"] | of_poses["properties"],
        "required": sorted([*beside["required"], *of_poses["required"]]),
        "additionalProperties": True,
    }


def _terse(schema: Any) -> Any:
    """A schema without titles, which repeat the keys, and without defaults, which are Python's."""
    if isinstance(schema, list):
        return [_terse(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    return {key: _terse(value) for key, value in schema.items() if key != "default" and not (key == "title" and isinstance(value, str))}
