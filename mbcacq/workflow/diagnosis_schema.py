"""The JSON Schema of a diagnosis of poses, made from the types of its parts: what ``DiagnosisResult.to_dict`` writes, and nothing by hand.

It is kept in the package as the contract with other programs (``mbcacq.diagnosis.schema``), and a test compares the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaMode

from mbcacq.calibration.observation_fit import EstimatedNoise, Parameter
from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.motion.result import MotionCheck
from mbcacq.diagnosis.result import FORMAT, Diagnosis, GivenEvidence
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.model.json_text import Number
from mbcacq.simulation.model_match import ModelMatch

LEFT_OUT = {*Parameter.left_out, *EstimatedNoise.left_out, *EffectTerm.left_out}  # keys that are not written where they say nothing
LATER = {  # keys that came in the course of version 3: an older file of it lacks them
    "geometry_alone",
    "exclusion_limits",
    "between_recordings",
    "proposals",
    "noise_depends_on",
    "evidence",
    "untried",
    "odds",
    "in_usual_sizes",
    "tested",
    "holds_for",
    "prior",
    "log_prior",
}
NOT_WRITTEN = {"plot_data"}
ABOUT = (
    "What mbcacq diagnose says about a recording of poses. Lengths mm, angles rad unless a name says deg; a number that is not finite is "
    "null."
)


class RecordingFigures(BaseModel):
    """Before and after in one recording: the one learnt from, or one that it was tried on."""

    name: str
    role: Literal["learnt", "checked"]
    before_rms_mm: Number
    after_rms_mm: Number
    held_out_before_rms_mm: Number
    held_out_after_rms_mm: Number


class FileRead(BaseModel):
    """A file of the recording."""

    file: str
    bytes: int
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class Provenance(BaseModel):
    """What the diagnosis is of, and made by."""

    recording: str | None = None
    files: list[FileRead] | None = None
    versions: Mapping[str, str] | None = None
    options: Mapping[str, Any] | None = None


class BesideDiagnosis(BaseModel):
    """The keys of the document beside those of the diagnosis of the poses. motion, given_motion, agreement, decided, together: of a
    recording that moved between them."""

    format: Literal["mbcacq-diagnosis/3"]
    recordings: Annotated[list[RecordingFigures], Field(min_length=1)]
    checks: tuple[Transfer, ...]
    provenance: Provenance
    motion: Mapping[str, Any] | None = None
    given_motion: GivenEvidence | None = None
    motion_checks: tuple[MotionCheck, ...] | None = None
    simulation: ModelMatch | None = None
    agreement: list[Mapping[str, Any]] | None = None
    decided: list[Mapping[str, Any]] | None = None
    together: Mapping[str, Any] | None = None


class _AsWritten(GenerateJsonSchema):
    """Every field of a dataclass is written, also where it has a default, but for those that are left out or came later."""

    def field_is_required(self, field: Any, total: bool) -> bool:
        if field["type"] == "dataclass-field":
            return field["name"] not in LEFT_OUT | LATER
        return super().field_is_required(field, total)


def generated_schema() -> dict[str, Any]:
    """The schema (JSON Schema 2020-12) as Python lists and dictionaries."""
    kinds: list[Any] = [Diagnosis, BesideDiagnosis]
    each: list[tuple[str, JsonSchemaMode, TypeAdapter[Any]]] = [(kind.__name__, "validation", TypeAdapter(kind)) for kind in kinds]
    found, shared = TypeAdapter.json_schemas(each, schema_generator=_AsWritten)
    parts = _terse(shared.pop("$defs"))
    of_poses, beside = (_resolved(_terse(found[kind.__name__, "validation"]), parts) for kind in kinds)
    properties = {key: value for key, value in (beside["properties"] | of_poses["properties"]).items() if key not in NOT_WRITTEN}
    required = [key for key in (*beside["required"], *of_poses["required"]) if key not in NOT_WRITTEN]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": FORMAT.replace("/", "-"),
        "title": FORMAT,
        "description": ABOUT,
        "$defs": dict(sorted(parts.items())),
        "type": "object",
        "properties": properties,
        "required": sorted(required),
        "additionalProperties": True,
    }


def _terse(schema: Any) -> Any:
    """A schema without titles, which repeat the keys, and without defaults, which are Python's."""
    if isinstance(schema, list):
        return [_terse(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    return {key: _terse(value) for key, value in schema.items() if key != "default" and not (key == "title" and isinstance(value, str))}


def _resolved(found: dict[str, Any], parts: dict[str, Any]) -> dict[str, Any]:
    """A schema that may be a reference to one of the parts, which is taken out."""
    return parts.pop(found["$ref"].rsplit("/", 1)[-1]) if "$ref" in found else found
