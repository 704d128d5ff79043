"""The files of a diagnosis: a page that opens offline, a recording for the viewer, and what is kept in the folder of a run."""

from __future__ import annotations

import json
from pathlib import Path

from mbcacq.diagnosis.output.figures import pictures
from mbcacq.diagnosis.output.text import words
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.errors import RecordingError
from mbcacq.model.observations import Observations
from mbcacq.recording import write_diagnosis
from mbcacq.report import write_diagnosis_page

DIAGNOSIS_JSON, PICTURES_JSON = "diagnosis.json", "diagnosis-pictures.json"


def write_html(diagnosis: Diagnosis, path: Path) -> None:
    """The diagnosis as a page of its own, one self-contained file."""

    write_diagnosis_page(diagnosis.to_json(), pictures(diagnosis), path)


def write_rrd(diagnosis: Diagnosis, observations: Observations, path: Path) -> None:
    """Arrows before and after in the cell, the misfit of each pose, and the variable held responsible, for the viewer."""

    write_diagnosis(path, observations, words(diagnosis), pictures(diagnosis))


def keep_beside(diagnosis: Diagnosis, observations: Observations, run: Path) -> None:
    """Into the folder of a run: diagnosis.json, what its pictures need, and diagnosis.rrd, so that report and viewer show it.

    Raises RecordingError where that cannot be written.
    """

    drawn = pictures(diagnosis)
    try:
        (run / DIAGNOSIS_JSON).write_text(json.dumps(diagnosis.to_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        (run / PICTURES_JSON).write_text(json.dumps(drawn, allow_nan=False), encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"the diagnosis cannot be kept in {run}: {error.strerror}; free the disk, or make it writable") from error
    write_diagnosis(run / "diagnosis.rrd", observations, words(diagnosis), drawn, run)
