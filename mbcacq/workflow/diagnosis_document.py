"""What stands in the document of a diagnosis beside the diagnosis of the poses: recordings, checks, motion, provenance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.motion.combine import BothInFile
from mbcacq.diagnosis.motion.result import MotionCheck
from mbcacq.diagnosis.result import FitSummary
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
class BesidePoses(BothInFile):
    """The keys of the document beside those of the diagnosis of the poses. A diagnosis of motion alone has simulation, motion_checks."""

    left_out = (*BothInFile.left_out, "simulation", "motion_checks")

    simulation: ModelMatch | None = None
    recordings: Annotated[tuple[RecordingFigures, ...], Field(json_schema_extra={"minItems": 1})]
    checks: tuple[Transfer, ...]
    provenance: Provenance
    motion_checks: tuple[MotionCheck, ...] | None = None


BEFORE_VERSION_3: dict[str, Any] = {"recordings": (), "checks": (), "provenance": {}}  # where an older document lacks these keys
