"""Result as CSV (RFC 4180, units in the column names): parameters, covariance, verification, residuals."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mbcacq.calibration.result_io import state_from_dict
from mbcacq.geometry import orientations
from mbcacq.model.observations import Observations
from mbcacq.quantities import in_degrees
from mbcacq.recording.datasets import quaternions
from mbcacq.report.sources.measured import residuals

FORMULA = ("=", "+", "-", "@", "\t", "\r")  # a cell that begins so is a formula to spreadsheets


def parameters_csv(result: Mapping[str, Any]) -> str:
    """name, value, error (value minus nominal), std, unit, status, reason of every parameter."""
    keys = ("name", "value", "error", "std", "unit", "status", "reason")
    return _csv(result, keys, ([p.get(k) for k in keys] for p in result["parameters"]))


def covariance_csv(result: Mapping[str, Any]) -> str:
    """Covariance of the free parameters, one row a parameter, in the units of the parameters."""
    return _csv(result, ["name", *result["names"]], ([name, *row] for name, row in zip(result["names"], result["covariance"], strict=True)))


def verification_csv(result: Mapping[str, Any]) -> str:
    """Sphere spacing errors at each place; only the header where nothing was verified."""
    places = (result.get("verification") or {}).get("places") or []
    keys = ("station", "ball_a", "ball_b", "certified_mm", "before_mm", "after_mm", "expected_mm")
    return _csv(result, keys, ([p["station"], *p["balls"], *(p.get(k) for k in keys[3:])] for p in places))


def tool_frames_csv(result: Mapping[str, Any], T: np.ndarray) -> str:
    """The frame on the flange, T (4, 4) mm, as the tool of each make's controller: what to type or paste, in its units and convention."""
    x, y, z = T[:3, 3].tolist()

    def numbers(maker: str) -> np.ndarray:
        return orientations.to_numbers(T[None, :3, :3], orientations.MAKERS[maker])[0]

    a, b, c = in_degrees(numbers("kuka"))
    w, p, r = in_degrees(numbers("fanuc"))
    rx, ry, rz = numbers("ur")
    q = ",".join(f"{v:.9f}" for v in quaternions.from_matrix(T[:3, :3]))
    place = f"{x:.4f},{y:.4f},{z:.4f}"
    rows = [
        ("KUKA", "TOOL_DATA, mm and deg", f"{{X {x:.4f},Y {y:.4f},Z {z:.4f},A {a:.5f},B {b:.5f},C {c:.5f}}}"),
        ("Universal Robots", "URScript, m and rad", f"set_tcp(p[{x / 1e3:.7f},{y / 1e3:.7f},{z / 1e3:.7f},{rx:.7f},{ry:.7f},{rz:.7f}])"),
        ("ABB", "tframe of tooldata, mm and quaternion", f"[[{place}],[{q}]]"),
        ("FANUC", "UTOOL, mm and deg", f"X {x:.4f} Y {y:.4f} Z {z:.4f} W {w:.5f} P {p:.5f} R {r:.5f}"),
    ]  # fmt: skip
    return _csv(result, ("controller", "place", "frame"), rows)


def residuals_csv(result: Mapping[str, Any], observations: Observations) -> str:
    """Measured minus predicted of every centre of the calibrated poses, in the scanner frame."""
    found = residuals(observations, result, state_from_dict(dict(result), observations.cell))
    assert found.weighted is not None, "a result has noise, by which the residuals are weighted"
    assert found.outlier is not None, "residuals of observations say which are rejected"
    rows = zip(found.pose, found.phase, found.ball, found.xyz, found.weighted, found.outlier, strict=True)
    return _csv(
        result,
        ["pose", "phase", "ball", "dx_mm", "dy_mm", "dz_mm", "dx_over_sigma", "dy_over_sigma", "dz_over_sigma", "used"],
        ([int(p), phase, int(b), *xyz, *w, int(not out)] for p, phase, b, xyz, w, out in rows),
    )


def _csv(result: Mapping[str, Any], header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table; of a simulated result, each row ends with 'true' in a column 'simulated'."""
    mark = (["simulated"], ["true"]) if result.get("simulated") else ([], [])
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow([*(_cell(name) for name in header), *mark[0]])
    for row in rows:
        writer.writerow([*(_cell(v) for v in row), *mark[1]])
    return out.getvalue()


def _cell(value: Any) -> Any:
    """Shortest text that reads back to the same float; nothing for None. A spreadsheet would compute a text that begins as a formula does:
    it gets an apostrophe in front."""
    if value is None:
        return ""
    if isinstance(value, str) and value.startswith(FORMULA):
        return f"'{value}"
    return repr(float(value)) if isinstance(value, float | np.floating) else value
