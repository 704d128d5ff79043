"""The files of a diagnosis: a recording for the viewer, and what is kept in the folder of a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.in_words import CHANNELS
from mbcacq.files.atomic_write import write_files
from mbcacq.model.observations import Observations
from mbcacq.quantities import capitalised
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.checksums import note_made
from mbcacq.recording.rrd.diagnosis_recording import stream_diagnosis, write_diagnosis
from mbcacq.recording.rrd.motion_recording import MotionDrawn, write_motion
from mbcacq.report.cards import diagnosis_cards
from mbcacq.report.sources.from_diagnosis import diagnosis_content
from mbcacq.report.sources.from_motion import motion_content

DIAGNOSIS_JSON, PICTURES_JSON = "diagnosis.json", "diagnosis-pictures.json"


def write_rrd(observations: Observations, cards: str, pictures: dict[str, Any], path: Path, motion: MotionDiagnosis | None = None) -> None:
    """Arrows before and after in the cell, the misfit of each pose, and the covariate held responsible, for the viewer; and the motion
    between the poses."""
    write_diagnosis(path, observations, cards, pictures, motion=None if motion is None else _drawn(motion))


def write_motion_rrd(found: MotionDiagnosis, path: Path) -> Path:
    """The channels of a motion over time, measured and as the model has them, with the verdict as text."""
    return write_motion(path, _drawn(found))


def _drawn(found: MotionDiagnosis) -> MotionDrawn:
    titles = {kind: capitalised(text) for kind, text in CHANNELS.items()}
    return MotionDrawn(found.series, diagnosis_cards(motion_content(found)), titles)


def keep_in_run(content: dict[str, Any], cards: str, pictures: dict[str, Any], observations: Observations, run: Path) -> None:
    """Write diagnosis.json, what its pictures need, and diagnosis.rrd into the folder of a run, where report and viewer find them.

    Raises RecordingError where that cannot be written.
    """
    files = {
        DIAGNOSIS_JSON: json.dumps(content, indent=1, allow_nan=False) + "\n",
        PICTURES_JSON: json.dumps(pictures, allow_nan=False),
        layout.DIAGNOSIS_FILE: lambda partial: stream_diagnosis(partial, observations, cards, pictures, run),
    }
    write_files(run, files, on_disk=lambda name, partial: note_made(partial, run / name))


def cards_of(found: Diagnosis) -> str:
    """The diagnosis of poses as Markdown for the viewer: a card an effect."""
    return diagnosis_cards(diagnosis_content(found, None))
