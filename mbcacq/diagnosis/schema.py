"""The JSON Schema of a diagnosis, format mbcacq-diagnosis/2, generated from the types of which it is written."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.result import FORMAT, Diagnosis, Number

DIALECT = "https://json-schema.org/draft/2020-12/schema"
# What is written only where there is something of it, as each type says of itself in its ``to_dict``.
WHERE_THERE_IS_SOME = {"turn_rad", "reason", "motion", "simulation", "agreement", "decided"}
Object = dict[str, Any]


@dataclass(frozen=True)
class RecordingFigures:
    """Before and after in a recording: the one learnt from, or one that the diagnosis was checked on."""

    name: str
    role: Literal["learnt", "checked"]
    before_rms_mm: Number
    after_rms_mm: Number
    held_out_before_rms_mm: Number
    held_out_after_rms_mm: Number


@dataclass(frozen=True)
class HashedFile:
    """A file that the diagnosis was made from."""

    file: str
    bytes: int
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


@dataclass(frozen=True)
class Provenance:
    """What the diagnosis was made from, and by which versions and options."""

    recording: str
    files: tuple[HashedFile, ...]
    versions: Mapping[str, str]
    options: Object


@dataclass(frozen=True)
class DiagnosisContent(Diagnosis):
    """What mbcacq diagnose says about a recording of poses. Lengths mm, angles rad unless a name says deg; a number that is not finite is
    null.

    recordings: before and after in each of them. checks: on other recordings. motion: diagnosis of the motion between the poses, format
    mbcacq-diagnosis/1. agreement, decided: what poses and motion both found, and what one decides that the other cannot. simulation: the
    model file that the recording was compared with.
    """

    format: Literal["mbcacq-diagnosis/2"] = FORMAT
    recordings: tuple[RecordingFigures, ...] = ()
    checks: tuple[Transfer, ...] = ()
    provenance: Provenance | Annotated[Object, Field(max_length=0)] = Field(default_factory=dict)
    motion: Object | None = None
    agreement: tuple[Object, ...] = ()
    decided: tuple[Object, ...] = ()
    simulation: Object | None = None


class _AsWritten(GenerateJsonSchema):
    """Every field is written, also one that has a default."""

    def field_is_required(self, field: Any, total: bool) -> bool:
        return True


@cache
def _generated() -> str:
    schema = TypeAdapter(DiagnosisContent).json_schema(schema_generator=_AsWritten)
    for part in (schema, *schema["$defs"].values()):
        part.get("properties", {}).pop("plot_data", None)  # no part of what is written
        if "required" in part:
            part["required"] = sorted(set(part["required"]) - WHERE_THERE_IS_SOME - {"plot_data"})
    return json.dumps({"$schema": DIALECT, "$id": "mbcacq-diagnosis-2", **schema, "title": FORMAT}, indent=1)


def schema_text() -> str:
    """The schema as text (JSON Schema 2020-12)."""
    return _generated()


def diagnosis_schema() -> dict[str, Any]:
    """The schema as Python lists and dictionaries."""
    return json.loads(_generated())
