"""The pictures of a diagnosis as a JSON object, which report and viewer draw."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from mbcacq.diagnosis.output.plot_data import PlotData
from mbcacq.diagnosis.output.response_curves import ResponseCurve
from mbcacq.diagnosis.result import Diagnosis, plain
from mbcacq.errors import ConfigError

FORMAT = "mbcacq-diagnosis-pictures/1"
MOST_CENTRES, MOST_POINTS = 4000, 800  # kept for pictures: of the recording, of a curve
FOLDED = 6.0  # periods a turn from which a harmonic is shown as one period


def pictures(diagnosis: Diagnosis) -> dict[str, Any]:
    """The JSON object from which pictures are drawn: lengths in mm, in base axes; the centres of a long recording evenly thinned.

    Raises ConfigError for a diagnosis that was read from JSON, which has no plot data.
    """
    data = diagnosis.plot_data
    if not isinstance(data, PlotData):
        raise ConfigError("a diagnosis that was read from JSON has nothing to draw pictures from; diagnose the recording again")
    keep = np.arange(0, len(data.points), len(data.points) // MOST_CENTRES + 1)
    causes = [n for n in dict.fromkeys(m.depends_on for m in diagnosis.mismatch) if n in data.covariates][:4]
    return plain(
        {
            "format": FORMAT,
            "map": [{"at": at, "depends_on": on, "strength": strength} for (at, on), strength in data.evidence_map.items()],
            "centres": {
                "pose": data.pose[keep],
                "ball": data.ball[keep],
                "point_mm": _short(data.points[keep]),
                "before_mm": _short(data.before[keep]),
                "after_mm": _short(data.after[keep]),
                "of": len(data.points),
            },
            "causes": [_cause(name, data.covariates[name][keep]) for name in causes],
            "curves": [_curve(c) for c in data.curves],
        }
    )


def axis_of(depends_on: str) -> tuple[str, str, float]:
    """Label, unit and factor to that unit of a covariate."""
    for pattern, label, unit, factor in (
        (r"q(\d+)", "angle of A{}", "deg", 180 / np.pi),
        (r"gravity_torque_(\d+)", "gravity torque about A{}", "N m", 1.0),
        (r"direction_(\d+)", "direction of A{}'s last motion", "", 1.0),
        (r"time", "time", "min", 1 / 60),
        (r"pose", "order of measurement", "", 1.0),
        (r"qd(\d+)", "speed of A{}", "deg/s", 180 / np.pi),
        (r"tau(\d+)", "motor torque of A{}", "N m", 1.0),
        (r"([xyz])", "position in the view along {}", "mm", 1.0),
        (r"tilt", "tilt of the artefact in the view", "deg", 180 / np.pi),
        (r"payload_kg", "payload", "kg", 1.0),
        (r"(.+)_C", "temperature {}", "°C", 1.0),
    ):
        if match := re.fullmatch(pattern, depends_on):
            return label.format(*match.groups()).replace("_", " "), unit, factor
    return depends_on.replace("_", " "), "", 1.0


def _cause(name: str, values: np.ndarray) -> dict[str, Any]:
    label, unit, factor = axis_of(name)
    return {"name": name, "label": label, "unit": unit, "values": _short(factor * values)}


def _curve(curve: ResponseCurve) -> dict[str, Any]:
    label, unit, factor = axis_of(curve.depends_on)
    x = factor * curve.x
    if curve.order is not None and curve.order > FOLDED:
        label, x = f"phase of {curve.at}'s {curve.order:.5g} waves a turn", np.degrees(np.mod(curve.x * curve.order, 2 * np.pi))
    order = np.argsort(x, kind="stable")
    order = order[:: len(order) // MOST_POINTS + 1]
    columns = {"y": _short(curve.y[order]), "std": _short(curve.std[order]), "seen": _short(curve.measured[order])}
    return {
        "effect": curve.effect,
        "at": curve.at,
        "what": curve.what,
        "unit": curve.unit,
        "depends_on": curve.depends_on,
        "x_label": label,
        "x_unit": unit,
        "x": _short(x[order]),
        **columns,
    }


def _short(values: np.ndarray) -> list:
    """The values with six significant digits, which is enough for any picture and a third of the size."""
    values = np.asarray(values, dtype=float)
    with np.errstate(all="ignore"):
        size = np.where(values == 0, 1.0, 10.0 ** (5 - np.floor(np.log10(np.abs(values)))))
    return np.where(np.isfinite(size), np.round(values * size) / size, values).tolist()
