"""Parameters as tables: one row an axis or a ball where they come in rows, a plain list otherwise."""

from __future__ import annotations

import re
from dataclasses import dataclass

from mbcacq.model.cell import axis_of_tag
from mbcacq.report.content import Content, ParameterRow

MDH = {"theta": "θ / °", "d": "d / mm", "a": "a / mm", "alpha": "α / °", "beta": "β / °"}
_KINEMATIC = re.compile(r"(theta|d|a|alpha|beta)_(E?\d+)")
_BALL = re.compile(r"ball_(.+)\.([xyz])")


@dataclass(frozen=True)
class Matrix:
    """heads: column titles; rows: (name, cells), a cell a ParameterRow or None. Corrections are shown times ``scale``."""

    title: str
    corner: str
    heads: list[str]
    rows: list[tuple[str, list[ParameterRow | None]]]
    scale: float = 1.0
    note: str = ""


def matrices(content: Content) -> list[Matrix]:
    """Kinematic errors by axis, as in the literature, and ball corrections by ball."""
    kinematic = _table(content.parameters, _KINEMATIC, lambda m: (axis_of_tag(m.group(2)), m.group(1)), list(MDH))
    balls = _table([p for p in content.parameters if p.held is None], _BALL, lambda m: (m.group(1), m.group(2)), list("xyz"))
    out = []
    if any(p is not None and p.held is None for _, cells in kinematic for p in cells):
        out.append(
            Matrix(
                "Kinematic errors, MD-H",
                "axis",
                list(MDH.values()),
                kinematic,
                note="Calibrated minus nominal, with expanded uncertainties U (k = 2).",
            )
        )
    if balls:
        out.append(
            Matrix(
                "Ball centres against their certificate",
                "ball",
                ["x / µm", "y / µm", "z / µm"],
                balls,
                1e3,
                "Estimated within the uncertainty of the certificate, in the artefact's frame.",
            )
        )
    return out


def groups(content: Content) -> list[tuple[str, list[ParameterRow]]]:
    """Free parameters that are in no matrix, by their group, in the order in which they come."""
    rest = [p for p in content.parameters if p.held is None and not _KINEMATIC.fullmatch(p.name) and not _BALL.fullmatch(p.name)]
    return [(name, [p for p in rest if p.group == name]) for name in dict.fromkeys(p.group for p in rest)]


def held(content: Content) -> list[tuple[str, list[str]]]:
    """Reasons for which parameters were held, each with the names."""
    kept = content.parameters
    out: list[tuple[str, list[str]]] = []
    if content.hand_eye_alone:
        arm = [p for p in kept if _KINEMATIC.fullmatch(p.name)]
        kept = [p for p in kept if not _KINEMATIC.fullmatch(p.name)]
        out.append(("the arm is taken as nominal", [f"the arm's {len(arm)} parameters"]))
    reasons = dict.fromkeys(p.held for p in kept if p.held is not None)
    return out + [(reason, [p.label for p in kept if p.held == reason]) for reason in reasons]


def _table(parameters: list[ParameterRow], pattern: re.Pattern, place, columns: list[str]) -> list[tuple[str, list[ParameterRow | None]]]:
    rows: dict[str, dict[str, ParameterRow]] = {}
    for p in parameters:
        if match := pattern.fullmatch(p.name):
            row, column = place(match)
            rows.setdefault(row, {})[column] = p
    return [(name, [cells.get(c) for c in columns]) for name, cells in rows.items()]
