"""What the pictures of a diagnosis are drawn from, as plain JSON."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.diagnosis.nonparametric.evidence_map import MapEntry
from mbcacq.diagnosis.output.response_curves import ResponseCurve
from mbcacq.diagnosis.result import Diagnosis, plain

FORMAT = "mbcacq-diagnosis-pictures/1"
MOST_CENTRES, MOST_POINTS = 4000, 800  # kept for pictures: of the recording, of a curve
FOLDED = 6.0  # periods a turn from which a wave is shown as one period


@dataclass(frozen=True)
class PlotData:
    """spots: makes the map before any effect. points: (M, 3) mm measured centres, base frame.

    before, after: (M, 3) mm residuals in base axes.

    covariates: name -> (M,) values. pose, ball: (M,) numbers. curves: makes the shape of each effect.
    """

    spots: Callable[[], list[MapEntry]]
    points: np.ndarray
    before: np.ndarray
    after: np.ndarray
    covariates: dict[str, np.ndarray]
    pose: np.ndarray | None = None
    ball: np.ndarray | None = None
    curves: Callable[[], list[ResponseCurve]] = list


def pictures(diagnosis: Diagnosis) -> dict[str, Any]:
    """What the pictures need, as JSON: lengths mm, in base axes. Of a long recording evenly thinned."""
    evidence = diagnosis.evidence
    keep = np.arange(0, len(evidence.points), len(evidence.points) // MOST_CENTRES + 1)
    causes = [n for n in dict.fromkeys([m["depends_on"] for m in diagnosis.mismatch]) if n in evidence.covariates][:4]
    return plain(
        {
            "format": FORMAT,
            "map": [{"at": p.at, "depends_on": p.depends_on, "strength": -p.log10_p} for p in evidence.spots()],
            "centres": {
                "pose": _kept(evidence.pose, keep),
                "ball": _kept(evidence.ball, keep),
                "point_mm": _short(evidence.points[keep]),
                "before_mm": _short(evidence.before[keep]),
                "after_mm": _short(evidence.after[keep]),
                "of": len(evidence.points),
            },
            "causes": [_cause(name, evidence.covariates[name][keep]) for name in causes],
            "curves": [_curve(c) for c in evidence.curves()],
        }
    )


def axis_of(depends_on: str) -> tuple[str, str, float]:
    """Words, unit and factor to that unit for what an effect may depend on."""
    for pattern, words, unit, factor in (
        (r"q(\d+)", "angle of A{}", "deg", 180 / np.pi),
        (r"gravity_torque_(\d+)", "gravity torque about A{}", "N m", 1.0),
        (r"direction_(\d+)", "sense of A{}'s last motion", "", 1.0),
        (r"time", "time", "min", 1 / 60),
        (r"pose", "order of measurement", "", 1.0),
        (r"qd(\d+)", "speed of A{}", "deg/s", 180 / np.pi),
        (r"tau(\d+)", "motor torque of A{}", "N m", 1.0),
        (r"([xyz])", "place in the view along {}", "mm", 1.0),
        (r"tilt", "tilt of the artefact in the view", "deg", 180 / np.pi),
        (r"payload_kg", "payload", "kg", 1.0),
        (r"(.+)_C", "temperature {}", "°C", 1.0),
    ):
        if match := re.fullmatch(pattern, depends_on):
            return words.format(*match.groups()).replace("_", " "), unit, factor
    return depends_on.replace("_", " "), "", 1.0


def _kept(numbers: np.ndarray | None, keep: np.ndarray) -> np.ndarray:
    return np.zeros(len(keep), int) if numbers is None else numbers[keep]


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
    columns = {name: _short(getattr(curve, name)[order]) for name in ("y", "std", "seen")}
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
    """Six significant digits: enough for any picture, a third of the size."""
    values = np.asarray(values, dtype=float)
    with np.errstate(all="ignore"):
        size = np.where(values == 0, 1.0, 10.0 ** (5 - np.floor(np.log10(np.abs(values)))))
    return np.where(np.isfinite(size), np.round(values * size) / size, values).tolist()
