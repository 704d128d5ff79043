"""What stands in the document of a diagnosis beside the diagnosis of the poses: recordings, checks, motion, provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import Field, WithJsonSchema

from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.motion.result import MotionCheck
from mbcacq.diagnosis.result import FORMAT, FitSummary, GivenEvidence
from mbcacq.model.json_text import EveryKey, Number
from mbcacq.simulation.model_match import ModelMatch


@dataclass(frozen=True)
class RecordingFigures:
    """Before and after in one recording: the one learnt from, or one that it was tried on."""

    name: str
    role: Literal["learnt", "checked"]
    before_rms_mm: Number
    after_rms_mm: Number
    held_out_before_rms_mm: Number
    held_out_after_rms_mm: Number

    @classmethod
    def learnt(cls, name: str, fit: FitSummary) -> Self:
        """The figures of the recording that the diagnosis is of."""
        train, held = fit.train, fit.held_out
        return cls(name, "learnt", train.before_rms_mm, train.after_rms_mm, held.before_rms_mm, held.after_rms_mm)

    @classmethod
    def checked(cls, check: Transfer) -> Self:
        """The figures of a recording that the effects were tried on: all of it is held out."""
        return cls(check.recording, "checked", *2 * (check.geometry_alone.rms_mm, check.with_effects.rms_mm))


@dataclass(frozen=True)
class FileRead:
    """A file of the recording."""

    file: str
    bytes: int
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


@dataclass(frozen=True)
class Provenance(EveryKey):
    """What the diagnosis is of, and made by."""

    left_out = ("recording", "files", "versions", "options")

    recording: str | None = None
    files: tuple[FileRead, ...] | None = None
    versions: Mapping[str, str] | None = None
    options: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class BesidePoses(EveryKey):
    """The keys of the document beside those of the diagnosis of the poses. motion, given_motion, agreement, decided, together: of a
    recording that moved between them."""

    left_out = ("given_motion", "simulation", "motion", "motion_checks", "agreement", "decided", "together")

    format: Annotated[str, WithJsonSchema({"type": "string", "const": FORMAT})] = FORMAT
    given_motion: GivenEvidence | None = None
    simulation: ModelMatch | None = None
    recordings: Annotated[tuple[RecordingFigures, ...], Field(json_schema_extra={"minItems": 1})]
    checks: tuple[Transfer, ...]
    provenance: Provenance
    motion: dict[str, Any] | None = None
    motion_checks: tuple[MotionCheck, ...] | None = None
    agreement: tuple[Mapping[str, Any], ...] | None = None
    decided: tuple[Mapping[str, Any], ...] | None = None
    together: Mapping[str, Any] | None = None


BEFORE_VERSION_3: dict[str, Any] = {"recordings": (), "checks": (), "provenance": {}}  # where an older document lacks these keys
