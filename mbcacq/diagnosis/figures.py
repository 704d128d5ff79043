"""What pictures of a diagnosis are drawn from, and the pictures: a page that opens offline, a recording for the viewer."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.diagnosis.curves import Curve
from mbcacq.diagnosis.locate import Spot
from mbcacq.diagnosis.result import Diagnosis, plain
from mbcacq.errors import RecordingError
from mbcacq.observations import Observations

FORMAT = "mbcacq-diagnosis-pictures/1"
DIAGNOSIS_JSON, PICTURES_JSON = "diagnosis.json", "diagnosis-pictures.json"
MOST_CENTRES, MOST_POINTS = 4000, 800      # kept for pictures: of the recording, of a curve
FOLDED = 6.0                               # periods a turn from which a wave is shown as one period


@dataclass(frozen=True)
class Evidence:
    """spots: makes the map before any effect. points: (M, 3) mm measured centres, base frame.

    before, after: (M, 3) mm residuals in base axes.

    covariates: name -> (M,) values. pose, ball: (M,) numbers. curves: makes the shape of each effect.
    """

    spots: Callable[[], list[Spot]]
    points: np.ndarray
    before: np.ndarray
    after: np.ndarray
    covariates: dict[str, np.ndarray]
    pose: np.ndarray | None = None
    ball: np.ndarray | None = None
    curves: Callable[[], list[Curve]] = list


def pictures(diagnosis: Diagnosis) -> dict[str, Any]:
    """What the pictures need, as JSON: lengths mm, in base axes. Of a long recording evenly thinned."""
    evidence = diagnosis.evidence
    keep = np.arange(0, len(evidence.points), len(evidence.points) // MOST_CENTRES + 1)
    causes = [n for n in dict.fromkeys([m["depends_on"] for m in diagnosis.mismatch]) if n in evidence.covariates][:4]
    return plain({
        "format": FORMAT,
        "map": [{"at": p.at, "depends_on": p.depends_on, "strength": -p.log10_p} for p in evidence.spots()],
        "centres": {"pose": _kept(evidence.pose, keep), "ball": _kept(evidence.ball, keep), "point_mm": _short(evidence.points[keep]),
                    "before_mm": _short(evidence.before[keep]), "after_mm": _short(evidence.after[keep]), "of": len(evidence.points)},
        "causes": [_cause(name, evidence.covariates[name][keep]) for name in causes],
        "curves": [_curve(c) for c in evidence.curves()],
    })


def axis_of(depends_on: str) -> tuple[str, str, float]:
    """Words, unit and factor to that unit for what an effect may depend on."""
    for pattern, words, unit, factor in (
        (r"q(\d+)", "angle of A{}", "deg", 180 / np.pi), (r"gravity_torque_(\d+)", "gravity torque about A{}", "N m", 1.0),
        (r"direction_(\d+)", "sense of A{}'s last motion", "", 1.0), (r"time", "time", "min", 1 / 60),
        (r"pose", "order of measurement", "", 1.0),
        (r"qd(\d+)", "speed of A{}", "deg/s", 180 / np.pi), (r"tau(\d+)", "motor torque of A{}", "N m", 1.0),
        (r"([xyz])", "place in the view along {}", "mm", 1.0), (r"tilt", "tilt of the artefact in the view", "deg", 180 / np.pi),
        (r"payload_kg", "payload", "kg", 1.0), (r"(.+)_C", "temperature {}", "°C", 1.0),
    ):
        if match := re.fullmatch(pattern, depends_on):
            return words.format(*match.groups()).replace("_", " "), unit, factor
    return depends_on.replace("_", " "), "", 1.0


def _kept(numbers: np.ndarray | None, keep: np.ndarray) -> np.ndarray:
    return np.zeros(len(keep), int) if numbers is None else numbers[keep]


def _cause(name: str, values: np.ndarray) -> dict[str, Any]:
    label, unit, factor = axis_of(name)
    return {"name": name, "label": label, "unit": unit, "values": _short(factor * values)}


def _curve(curve: Curve) -> dict[str, Any]:
    label, unit, factor = axis_of(curve.depends_on)
    x = factor * curve.x
    if curve.order is not None and curve.order > FOLDED:
        label, x = f"phase of {curve.at}'s {curve.order:.5g} waves a turn", np.degrees(np.mod(curve.x * curve.order, 2 * np.pi))
    order = np.argsort(x, kind="stable")
    order = order[:: len(order) // MOST_POINTS + 1]
    columns = {name: _short(getattr(curve, name)[order]) for name in ("y", "std", "seen")}
    return {"effect": curve.effect, "at": curve.at, "what": curve.what, "unit": curve.unit, "depends_on": curve.depends_on,
            "x_label": label, "x_unit": unit, "x": _short(x[order]), **columns}


def _short(values: np.ndarray) -> list:
    """Six significant digits: enough for any picture, a third of the size."""
    values = np.asarray(values, dtype=float)
    with np.errstate(all="ignore"):
        size = np.where(values == 0, 1.0, 10.0 ** (5 - np.floor(np.log10(np.abs(values)))))
    return np.where(np.isfinite(size), np.round(values * size) / size, values).tolist()


def write_html(diagnosis: Diagnosis, evidence: Evidence, path: Path) -> None:
    """The diagnosis as a page of its own, one self-contained file."""
    from mbcacq.report import write_diagnosis_page

    write_diagnosis_page(diagnosis.as_json(), pictures(diagnosis), path)


def write_rrd(diagnosis: Diagnosis, observations: Observations, path: Path) -> None:
    """Arrows before and after in the cell, the misfit of each pose, and the variable held responsible, for the viewer."""
    from mbcacq.diagnosis.text import words
    from mbcacq.recording import write_diagnosis

    write_diagnosis(path, observations, words(diagnosis), pictures(diagnosis))


def keep_beside(diagnosis: Diagnosis, observations: Observations, run: Path) -> None:
    """Into the folder of a run: diagnosis.json, what its pictures need, and diagnosis.rrd, so that report and viewer show it.

    Raises RecordingError where that cannot be written.
    """
    from mbcacq.diagnosis.text import words
    from mbcacq.recording import write_diagnosis

    drawn = pictures(diagnosis)
    try:
        (run / DIAGNOSIS_JSON).write_text(json.dumps(diagnosis.as_json(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        (run / PICTURES_JSON).write_text(json.dumps(drawn, allow_nan=False), encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"the diagnosis cannot be kept in {run}: {error.strerror}; free the disk, or make it writable") from error
    write_diagnosis(run / "diagnosis.rrd", observations, words(diagnosis), drawn, run)
