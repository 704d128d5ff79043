"""Certificates of artefacts, as a coordinate measuring machine writes them: CSV, YAML or DMIS output to an Artefact, and to our YAML.

CSV: a header with label (or ball, id), x, y, z, d (or diameter), optional U, sigma, k, T, alpha. Units stand in the headings (``x (cm)``,
``U_um``, ``alpha (1/K)``) or in a comment (``# units: cm``) and are honoured; without any they are mm, deg C, 1e-6/K. YAML: the same names
as keys, balls listed under ``balls`` or ``spheres``; or an artefact file of ours. Unused columns and lines are listed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.exports import dmis
from mbcacq.files.csv_text import read_csv_text, read_text, text_of_mappings
from mbcacq.files.stated_unit import in_words, stated_unit
from mbcacq.files.table import Column, Table, TableSchema, as_table
from mbcacq.files.table_schema import HeadingError, HeadingMatch, coverage_factor, matched, score
from mbcacq.model import yaml12
from mbcacq.model.cell import Artefact
from mbcacq.plan.plausibility import SMALLEST_BALL_MM

MAX_BYTES = 16 << 20
WHAT = "a certificate"
NEEDED = ("label", "x", "y", "z", "d")
LABEL = Column("label", kind="text", aliases=("ball", "id", "name", "feature", "sphere", "kugel"))
# Uncertainty of all balls, or of each.
ABOUT = (
    Column(
        "U", "mm", aliases=("uncertainty", "expanded_uncertainty", "u95", "unsicherheit", "messunsicherheit"), required=False, assumed="mm"
    ),
    Column("k", required=False, aliases=("coverage_factor",)),
    Column("T", "degC", aliases=("temperature", "reference_temperature", "temperatur"), required=False, assumed="degC"),
    Column("alpha", "ppm/K", aliases=("expansion", "cte", "ausdehnung"), required=False, assumed="ppm/K"),
)
SIGMA = Column("sigma", "mm", aliases=("std", "standard_uncertainty"), required=False, assumed="mm")
LARGEST_U_MM = 0.3  # of a certified sphere whose heading names no unit: in µm certificates write 0.5 and more
COLDEST_C, WARMEST_C = 0.0, 50.0  # of a measuring room
LEAST_PPM = 1e-3  # per K: glass ceramics expand by some 0.02
OURS = ("balls", "spheres", "unit", "units", "id", "name", "certificate", "comment", "notes")  # keys that say nothing of the geometry
_SMALL_U = re.compile(r"u(?![A-Za-z0-9])")


Row = dict[str, Any]  # of a sphere, by names of columns


@dataclass(frozen=True)
class Certificate:
    """unused: headings and keys that nothing was read from. notes: sentences on what was understood."""

    artefact: Artefact
    unused: tuple[str, ...]
    notes: tuple[str, ...]


def read_certificate_file(path: str | Path, artefact_id: str, name: str = "") -> Certificate:
    """An Artefact from a certificate: .csv, .yaml/.yml, or DMIS output (.dmo, .dmi, .dms). Raises ConfigError with file and line.

    Balls are numbered by the number at the end of their label where those are unique, else in order. The expanded uncertainty U is
    divided by its k (2 if not given), a standard uncertainty (sigma, or a small u) is taken as it is; where it differs between balls the
    largest counts.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        rows, unused, notes = _from_csv(path)
        about: Row = {}
    elif suffix in (".yaml", ".yml"):
        rows, about, unused = _from_yaml(path)
        notes = []
    elif suffix in (".dmo", ".dmi", ".dms"):
        rows, about, unused, notes = dmis.spheres(read_text(path, MAX_BYTES), str(path)), {}, (), []
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
    notes += [f"not used: {', '.join(unused)}"] if unused else []
    if not U:
        notes.append("no uncertainty was read from it; 0.001 mm (k = 1) is taken")
    return Certificate(artefact, tuple(unused), tuple(notes))


def _refuse_other_units(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Raise ConfigError for a diameter that is none in mm; 0 says that it is not known."""
    for row in rows:
        if 0 < float(row["d"]) < SMALLEST_BALL_MM:
            raise ConfigError(
                f"{path}: sphere '{row['label']}' has a diameter of {row['d']:g} mm, which looks like metres or inches; "
                "give all lengths in mm"
            )


def _schema(headings: Sequence[str], unit: str = "mm") -> TableSchema:
    """Columns of a table of spheres. unit: of lengths whose heading has none."""
    return TableSchema(WHAT, (*_geometry(unit), *_about(headings, unit)), max_bytes=MAX_BYTES, comment="#", preamble=True)


def _geometry(unit: str) -> tuple[Column, ...]:
    """Label, centre and diameter of a sphere."""
    lengths = (
        *(Column(axis, "mm", assumed=unit) for axis in "xyz"),
        Column("d", "mm", aliases=("diameter", "dia", "durchmesser"), assumed=unit),
    )
    return (LABEL, *lengths)


def _about(headings: Sequence[str], unit: str) -> tuple[Column, ...]:
    """Columns that are not of the geometry. A small u is a standard uncertainty, a capital one is expanded."""
    small = any(_SMALL_U.match(heading) and coverage_factor(heading) is None for heading in headings)
    sigma = replace(SIGMA, aliases=(*SIGMA.aliases, "u")) if small else SIGMA
    return tuple(replace(column, assumed=unit) if column.unit == "mm" else column for column in (sigma, *ABOUT))


def _from_csv(path: Path) -> tuple[list[Row], tuple[str, ...], list[str]]:
    """One row a sphere, what was not used, and notes."""
    schema = _schema(())
    text = read_csv_text(path, max_bytes=MAX_BYTES, comment="#", score=lambda headings: score(schema.columns, headings))
    above = "\n".join((*text.preamble, *text.comments))
    unit = stated_unit(above, str(path))
    table = as_table(path, text, _schema(text.headings, unit or "mm"))
    notes = (
        []
        if unit in ("", "mm")
        else [f"lengths whose heading names no unit are read in {in_words(unit)}, as the lines above the headings say"]
    )
    if text.preamble:
        notes.append(f"of the lines above the headings only a unit of length and k are read: {' | '.join(text.preamble)[:300]}")
    return _rows(table, coverage_factor(above)), table.unused, notes


def _rows(table: Table, k: float | None = None) -> list[Row]:
    """A row of values for each row of a table, without those that are empty. k: coverage factor, where no column or heading states it."""
    columns: dict[str, Any] = {name: table.text(name) if name == "label" else table.number(name) for name in NEEDED if table.has(name)}
    for row, label in enumerate(columns.get("label", ())):
        if not label.strip():
            raise ConfigError(f"{table.where(row, 'label')}: the cell is empty; name the sphere")
    columns |= {c.name: table.number(c.name, empty=np.nan) for c in (SIGMA, *ABOUT) if table.has(c.name)}
    if "k" not in columns:
        in_heading = coverage_factor(table.heading("U")) if table.has("U") else None
        columns["k"] = np.full(len(table), np.nan if (in_heading or k) is None else in_heading or k)
    for name, what in (("d", "diameter"), ("k", "coverage factor")):
        wrong = np.flatnonzero(columns.get(name, np.ones(1)) <= 0)
        if wrong.size:
            raise ConfigError(f"{table.where(int(wrong[0]), name)}: the {what} is not positive; correct the certificate")
    _refuse_implausible(table, columns)
    of_each = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
    return [{name: v for name, v in row.items() if isinstance(v, str) or not np.isnan(v)} for row in of_each]


def _refuse_implausible(table: Table, columns: Mapping[str, np.ndarray]) -> None:
    """Raise ConfigError for what looks like another unit: an uncertainty without unit, a temperature, an expansion."""
    for name, out_of, words in (
        ("U", lambda v: v > LARGEST_U_MM, "looks like µm; name its unit: U (µm) or U (mm)"),
        ("sigma", lambda v: v > LARGEST_U_MM, "looks like µm; name its unit: sigma (µm) or sigma (mm)"),
        ("T", lambda v: (v < COLDEST_C) | (v > WARMEST_C), "is no temperature of a measuring room in °C; name its unit: T (°F) or T (K)"),
        ("alpha", lambda v: (v != 0) & (np.abs(v) < LEAST_PPM), "in ppm/K looks like 1/K; name its unit: alpha (1/K)"),
    ):
        if name not in columns or (name in ("U", "sigma") and table.names_unit(name)):
            continue
        wrong = np.flatnonzero(out_of(columns[name]))
        if wrong.size:
            row = int(wrong[0])
            raise ConfigError(f"{table.where(row, name)}: {table.text(name)[row].strip()} {words}")


def _from_yaml(path: Path) -> tuple[list[Row], Row, tuple[str, ...]]:
    """One row a sphere, what holds for all of them, and keys that were not used."""
    data = _mapping(path)
    balls = data.get("balls", data.get("spheres"))
    if not isinstance(balls, list) or not balls:
        raise ConfigError(f"{path}: has no list 'balls' or 'spheres'; give one, with label, x, y, z and diameter of each")
    for i, ball in enumerate(balls, 1):
        if not isinstance(ball, dict):
            raise ConfigError(f"{path}: sphere {i} is not a mapping; give label, x, y, z and diameter")
    stated = data.get("units", data.get("unit"))
    unit = (stated_unit(f"unit: {stated}", str(path)) if stated is not None else "") or "mm"
    text = text_of_mappings(_under_one_heading(path, [_with_axes(ball) for ball in balls], unit), "sphere")
    table = as_table(path, text, _schema(text.headings, unit))
    # Our own artefact files give the standard uncertainty (k = 1) as uncertainty_mm.
    others = {("sigma_mm" if key == "uncertainty_mm" else str(key)): value for key, value in data.items() if key not in OURS}
    if not others:
        return _rows(table), {}, table.unused
    text = text_of_mappings([others], "of all spheres, line")
    about = as_table(path, text, TableSchema(WHAT, _about(text.headings, unit)))
    return _rows(table), _rows(about)[0], (*table.unused, *about.unused)


def _with_axes(ball: Mapping[Any, Any]) -> dict[str, Any]:
    """A sphere with its centre as three coordinates: ``centre_mm: [x, y, z]`` as x_mm, y_mm, z_mm."""
    out: dict[str, Any] = {}
    for key, value in ball.items():
        word, _, unit = str(key).partition("_")
        if word.lower() in ("centre", "center") and isinstance(value, list) and len(value) == 3:
            out |= {f"{axis}_{unit}" if unit else axis: v for axis, v in zip("xyz", value, strict=True)}
        else:
            out[str(key)] = value
    return out


def _under_one_heading(path: Path, balls: Sequence[Mapping[str, Any]], unit: str) -> list[dict[str, Any]]:
    """Spheres that name their place differently (x, x_mm, centre_cm) as rows of one table: each value under the heading of the first that
    gives it, with its own unit where that differs."""
    columns = {column.name: column for column in _geometry(unit)}
    first: dict[str, HeadingMatch] = {}
    out = []
    for i, ball in enumerate(balls, 1):
        try:
            found = matched(tuple(columns.values()), list(ball))
        except HeadingError as error:
            raise ConfigError(f"{path}: sphere {i}: {error}") from None
        row = dict(ball)
        for name, match in found.items():
            shared, assumed = first.setdefault(name, match), columns[name].assumed
            if shared.heading != match.heading and shared.heading not in row:
                value, own = row.pop(match.heading), match.unit or assumed
                row[shared.heading] = value if own == (shared.unit or assumed) else f"{value} {own}"
        out.append(row)
    return out


def _mapping(path: Path) -> dict[Any, Any]:
    """The mapping in a YAML file, an empty one where it holds something else."""
    try:
        data = yaml12.load(read_text(path, MAX_BYTES))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        raise ConfigError(f"{path}:{line}: is not YAML; correct the certificate") from error
    return data if isinstance(data, dict) else {}


def _numbers(labels: list[str]) -> tuple[int, ...]:
    """Numbers at the end of the labels where every label has one and none is repeated, else 1, 2, 3..."""
    numbers = tuple(int(m.group(1)) for n in labels if (m := re.search(r"(\d+)\D*$", n)))
    if len(numbers) == len(labels) == len(set(numbers)):
        return numbers
    return tuple(range(1, len(labels) + 1))


def _optional(value: Any) -> float | None:
    return None if value is None else float(value)
