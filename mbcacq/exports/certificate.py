"""Certificates of artefacts, as a coordinate measuring machine writes them: CSV, YAML or DMIS output to an Artefact, and to our YAML.

CSV: a header with label (or ball, id), x, y, z, d (or diameter), optional U, sigma, k, T, alpha. Units stand in the headings (``x (cm)``,
``U_um``, ``alpha (1/K)``) or in a comment (``# units: cm``) and are honoured; without any they are mm, deg C, 1e-6/K. YAML: the same names
as keys, balls listed under ``balls`` or ``spheres``; or an artefact file of ours. What is not used is listed.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.exports import dmis
from mbcacq.model import yaml12
from mbcacq.model.cell import Artefact
from mbcacq.model.heading_units import UnknownUnitError, converted, split_heading
from mbcacq.plan.plausibility import SMALLEST_BALL_MM

MAX_BYTES = 16 << 20
Row = dict[str, Any]  # of a certificate, by the keys that ALIASES leads to
NEEDED = ("label", "x", "y", "z", "d")
ALIASES = {
    "label": "label",
    "ball": "label",
    "id": "label",
    "name": "label",
    "feature": "label",
    "sphere": "label",
    "x": "x",
    "y": "y",
    "z": "z",
    "d": "d",
    "diameter": "d",
    "dia": "d",
    "u": "U",
    "uncertainty": "U",
    "expanded_uncertainty": "U",
    "sigma": "sigma",
    "std": "sigma",
    "standard_uncertainty": "sigma",
    "k": "k",
    "t": "T",
    "temperature": "T",
    "reference_temperature": "T",
    "alpha": "alpha",
    "expansion": "alpha",
    "cte": "alpha",
}
OURS = ("balls", "spheres", "unit", "units", "id", "name", "certificate", "comment", "notes")  # keys that say nothing of the geometry
WANTED = {"x": "mm", "y": "mm", "z": "mm", "d": "mm", "U": "mm", "sigma": "mm", "T": "degC", "alpha": "ppm/kelvin"}  # units inside
SEPARATORS = (",", ";", "\t")
LINE_END = re.compile(r"\r\n|\r|\n")
_UNITS = re.compile(r"\bunits?\b\W*(?:of length\W*)?([A-Za-zµμ]+)", re.IGNORECASE)


@dataclass(frozen=True)
class CertifiedColumn:
    """What a heading or key says. key: our name, None where it is not known; unit: '' for ours; k: coverage factor that stands in it."""

    heading: str
    key: str | None
    unit: str = ""
    k: float | None = None


@dataclass(frozen=True)
class Certificate:
    """unused: headings and keys that nothing was read from. notes: sentences on what was understood."""

    artefact: Artefact
    unused: tuple[str, ...]
    notes: tuple[str, ...]


def read_certificate(path: str | Path, artefact_id: str, name: str = "") -> Artefact:
    """The artefact of ``read_certificate_file``, where what was not used is of no interest."""
    return read_certificate_file(path, artefact_id, name).artefact


def read_certificate_file(path: str | Path, artefact_id: str, name: str = "") -> Certificate:
    """An Artefact from a certificate: .csv, .yaml/.yml, or DMIS output (.dmo, .dmi, .dms). Raises ConfigError with file and line.

    Balls are numbered by the number at the end of their label where those are unique, else in order. The expanded uncertainty U is
    divided by its k (2 if not given), a standard uncertainty (sigma, or a small u) is taken as it is; where it differs between balls the
    largest counts.
    """
    path = Path(path)
    text = _text(path)
    columns: list[CertifiedColumn] = []
    suffix = path.suffix.lower()
    if suffix == ".csv":
        rows, about = _from_csv(text, path, columns)
    elif suffix in (".yaml", ".yml"):
        rows, about = _from_yaml(text, path, columns)
    elif suffix in (".dmo", ".dmi", ".dms"):
        rows, about = dmis.spheres(text, str(path)), {}
    else:
        raise ConfigError(f"{path}: a certificate must be .csv, .yaml or DMIS output (.dmo), not '{suffix}'; convert it")
    if not rows:
        raise ConfigError(f"{path}: lists no sphere; a certificate needs label, x, y, z and diameter of each")
    labels = [str(r["label"]) for r in rows]
    if len(set(labels)) != len(labels):
        twice = next(n for n in labels if labels.count(n) > 1)
        raise ConfigError(f"{path}: sphere '{twice}' is listed twice; correct the certificate")
    _refuse_other_units(path, rows)
    U = [float(r["U"]) / float(r.get("k", about.get("k", 2.0))) for r in [*rows, about] if r.get("U") is not None]
    U += [float(r["sigma"]) for r in [*rows, about] if r.get("sigma") is not None]
    artefact = Artefact(
        id=artefact_id,
        name=name or artefact_id,
        ball_ids=_numbers(labels),
        centres=np.array([[r["x"], r["y"], r["z"]] for r in rows], dtype=float),
        diameters=np.array([r["d"] for r in rows], dtype=float),
        uncertainty_mm=max(U) if U else 0.001,
        reference_temperature_C=float(about.get("T", next((r["T"] for r in rows if r.get("T") is not None), 20.0))),
        expansion_ppm_per_K=_optional(about.get("alpha", next((r["alpha"] for r in rows if r.get("alpha") is not None), None))),
    )
    unused = tuple(dict.fromkeys(c.heading for c in columns if c.key is None and c.heading.strip()))
    notes = [f"not used: {', '.join(unused)}"] if unused else []
    if not U:
        notes.append("it states no uncertainty; 0.001 mm (k = 1) is taken")
    return Certificate(artefact, unused, tuple(notes))


def _refuse_other_units(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Raise ConfigError for a diameter that is none in mm; 0 says that it is not known."""
    for row in rows:
        if 0 < float(row["d"]) < SMALLEST_BALL_MM:
            raise ConfigError(
                f"{path}: sphere '{row['label']}' has a diameter of {row['d']:g} mm, which looks like metres or inches; "
                "give all lengths in mm"
            )


def artefact_yaml(artefact: Artefact) -> str:
    """The artefact as a YAML file for ``plans/artefacts`` or the ``artefacts`` of a cell."""
    data: dict[str, Any] = {"id": artefact.id, "name": artefact.name, "reference_temperature_C": float(artefact.reference_temperature_C)}
    if artefact.expansion_ppm_per_K is not None:
        data["expansion_ppm_per_K"] = float(artefact.expansion_ppm_per_K)
    data["uncertainty_mm"] = float(artefact.uncertainty_mm)
    data["balls"] = [
        {"id": int(b), "centre_mm": [float(v) for v in c], "diameter_mm": float(d)}
        for b, c, d in zip(artefact.ball_ids, artefact.centres, artefact.diameters, strict=True)
    ]
    return yaml12.dump(data, default_flow_style=None, width=140)


def certificate_csv(artefact: Artefact) -> str:
    """The artefact as CSV (RFC 4180) that ``read_certificate`` reads back, with U at k = 2."""
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(["label", "x_mm", "y_mm", "z_mm", "d_mm", "U_mm", "k", "T_C"])
    for ball, centre, diameter in zip(artefact.ball_ids, artefact.centres, artefact.diameters, strict=True):
        writer.writerow(
            [
                ball,
                *(repr(float(v)) for v in centre),
                repr(float(diameter)),
                repr(2 * float(artefact.uncertainty_mm)),
                2,
                repr(float(artefact.reference_temperature_C)),
            ]
        )
    return out.getvalue()


def _text(path: Path) -> str:
    try:
        raw = path.read_bytes()[: MAX_BYTES + 1]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give the certificate's file") from error
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; this is no certificate")
    try:
        return raw.decode("utf-16" if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _from_csv(text: str, path: Path, columns: list[CertifiedColumn]) -> tuple[list[Row], Row]:
    every = [(i, line) for i, line in enumerate(LINE_END.split(text), 1) if line.strip()]
    lines = [(i, line) for i, line in every if not line.lstrip().startswith("#")]
    if not lines:
        return [], {}
    unit = _unit_in(" ".join(line for _, line in every if line.lstrip().startswith("#")), str(path))
    separator = max(SEPARATORS, key=lines[0][1].count)
    columns += [_column(h) for h in _cells(lines[0][1], separator, f"{path}:{lines[0][0]}")]
    keys = [c.key for c in columns if c.key is not None]
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise ConfigError(f"{path}:{lines[0][0]}: two columns are '{twice}'; remove one")
    for needed in NEEDED:
        if needed not in keys:
            raise ConfigError(
                f"{path}:{lines[0][0]}: column '{needed}' is missing; a certificate needs label, x, y, z and d in mm, or with a unit"
            )
    rows = [_csv_row(line, separator, columns, unit, f"{path}:{number}") for number, line in lines[1:]]
    return [row for row in rows if row], {}


def _csv_row(line: str, separator: str, columns: list[CertifiedColumn], unit: str, where: str) -> Row:
    """One sphere; nothing of a row of empty cells. Raises ConfigError."""
    cells, row = _cells(line, separator, where), Row()
    while len(cells) > len(columns) and not cells[-1].strip():
        cells.pop()
    if not any(cell.strip() for cell in cells):
        return row
    if len(cells) != len(columns):
        raise ConfigError(f"{where}: {len(cells)} cells under {len(columns)} columns; correct the line")
    for column, cell in zip(columns, cells, strict=True):
        if column.key is not None and cell.strip():
            plain = cell.replace(",", ".") if separator != "," else cell
            _take(row, column, cell.strip() if column.key == "label" else plain, f"{where}: column '{column.key}'", unit)
    if missing := [k for k in NEEDED if row.get(k) in (None, "")]:
        raise ConfigError(f"{where}: column '{missing[0]}' is empty; correct the line")
    _positive(row, where)
    return row


def _cells(line: str, separator: str, where: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator, strict=True))
    except (csv.Error, StopIteration) as error:
        raise ConfigError(f"{where}: is no row of a table ({error}); correct the line") from None


def _unit_in(text: str, where: str) -> str:
    """The unit of length that a comment or a key states for all, '' without any. Raises ConfigError for one that is not known."""
    match = _UNITS.search(text)
    if match is None:
        return ""
    try:
        converted(1.0, match[1], "mm")
    except UnknownUnitError:
        raise ConfigError(f"{where}: the unit '{match[1]}' is no length that is known; give mm, cm, m, um or inch") from None
    return match[1]


def _column(heading: str) -> CertifiedColumn:
    name, unit, k = split_heading(heading)
    key = ALIASES.get(name)
    if key == "U" and heading.strip().startswith("u") and name == "u" and k is None:
        key = "sigma"  # a small u is a standard uncertainty, a capital one is expanded
    return CertifiedColumn(heading, key, unit, k)


def _take(row: Row, column: CertifiedColumn, value: Any, where: str, unit: str = "") -> None:
    """Put one value into a row, in our unit. unit: that of lengths whose heading has none. Raises ConfigError."""
    assert column.key is not None, "only known columns are read"
    if column.key == "label":
        row["label"] = str(value)
        return
    number, wanted = _number(value, where), WANTED.get(column.key)
    stated = column.unit or (unit if wanted == "mm" else "")
    if stated:
        try:
            number = converted(number, stated, wanted or "")
        except UnknownUnitError:
            of = f"can be given in {wanted}" if wanted else "belongs here"
            raise ConfigError(f"{where}: '{stated}' in '{column.heading}' is no unit that {of}; correct the heading") from None
    row[column.key] = number
    if column.k is not None:
        row["k"] = column.k


def _from_yaml(text: str, path: Path, columns: list[CertifiedColumn]) -> tuple[list[Row], Row]:
    data = _mapping(text, path)
    balls = data.get("balls", data.get("spheres"))
    if not isinstance(balls, list):
        raise ConfigError(f"{path}: has no list 'balls' or 'spheres'; give one, with label, x, y, z and diameter of each")
    stated = data.get("units", data.get("unit"))
    unit = _unit_in(f"unit {stated}", str(path)) if stated is not None else ""
    about = _yaml_about(data, path, columns, unit)
    return [_yaml_row(ball, f"{path}: sphere {i}", columns, unit) for i, ball in enumerate(balls, 1)], about


def _mapping(text: str, path: Path) -> dict[Any, Any]:
    """The mapping in a YAML text, an empty one where the text is something else."""
    try:
        data = yaml12.load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        raise ConfigError(f"{path}:{line}: is not YAML; correct the certificate") from error
    return data if isinstance(data, dict) else {}


def _yaml_about(data: dict[Any, Any], path: Path, columns: list[CertifiedColumn], unit: str) -> Row:
    """What holds for all spheres: U, k, T, alpha. Our own artefact files give the standard uncertainty (k = 1) as uncertainty_mm."""
    about: Row = {}
    for key, value in data.items():
        column = _column(str(key))
        if column.key in ("U", "sigma", "k", "T", "alpha") and value is not None:
            if key == "uncertainty_mm":
                column = CertifiedColumn(str(key), "sigma", "mm")
            _take(about, column, value, f"{path}: {key}", unit)
        elif key not in OURS:
            columns.append(CertifiedColumn(str(key), None))
    return about


def _yaml_row(ball: Any, where: str, columns: list[CertifiedColumn], unit: str) -> Row:
    if not isinstance(ball, dict):
        raise ConfigError(f"{where} is not a mapping; give label, x, y, z and diameter")
    row: Row = {}
    for key, value in ball.items():
        column = _column(str(key))
        name, stated, _ = split_heading(str(key))
        if column.key is not None and value is not None:
            _take(row, column, value, f"{where}: {key}", unit)
        elif name in ("centre", "center") and isinstance(value, list) and len(value) == 3:
            for axis, v in zip("xyz", value, strict=True):
                _take(row, CertifiedColumn(str(key), axis, stated), v, f"{where}: {key}", unit)
        else:
            columns.append(CertifiedColumn(str(key), None))
    if missing := [k for k in NEEDED if k not in row]:
        raise ConfigError(f"{where} has no '{missing[0]}'; a certificate needs label, x, y, z and diameter")
    _positive(row, where)
    return row


def _number(value: Any, where: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{where}: '{value}' is not a number; correct the certificate") from None
    if not np.isfinite(number) or isinstance(value, bool):
        raise ConfigError(f"{where}: '{value}' is not a finite number; correct the certificate")
    return number


def _positive(row: Row, where: str) -> None:
    for key, what in (("d", "diameter"), ("k", "coverage factor")):
        if row.get(key) is not None and row[key] <= 0:
            raise ConfigError(f"{where}: the {what} {row[key]:g} is not positive; correct the certificate")


def _numbers(labels: list[str]) -> tuple[int, ...]:
    """Numbers at the end of the labels where every label has one and none is repeated, else 1, 2, 3..."""
    numbers = tuple(int(m.group(1)) for n in labels if (m := re.search(r"(\d+)\D*$", n)))
    if len(numbers) == len(labels) == len(set(numbers)):
        return numbers
    return tuple(range(1, len(labels) + 1))


def _optional(value: Any) -> float | None:
    return None if value is None else float(value)
