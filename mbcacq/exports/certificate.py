"""Certificates of artefacts, as a coordinate measuring machine writes them: CSV, YAML or DMIS output to an Artefact, and to our YAML.

CSV: a header with label (or ball, id), x, y, z, d (or diameter), optional U, k, T, alpha; units mm, deg C, 1e-6/K; a unit or a bracket
after the name is ignored (``x_mm``, ``U (k=2)``). YAML: the same names as keys, balls listed under ``balls`` or ``spheres``; or an artefact
file of ours.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.exports import dmis
from mbcacq.model import yaml12
from mbcacq.model.cell import Artefact
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
    "k": "k",
    "t": "T",
    "temperature": "T",
    "reference_temperature": "T",
    "alpha": "alpha",
    "expansion": "alpha",
}


def read_certificate(path: str | Path, artefact_id: str, name: str = "") -> Artefact:
    """An Artefact from a certificate: .csv, .yaml/.yml, or DMIS output (.dmo, .dmi, .dms). Raises ConfigError with file and line.

    Balls are numbered by the number at the end of their label where those are unique, else in order. The expanded uncertainty U is
    divided by its k (2 if not given); where it differs between balls the largest counts.
    """
    path = Path(path)
    text = _text(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        rows, about = _from_csv(text, path)
    elif suffix in (".yaml", ".yml"):
        rows, about = _from_yaml(text, path)
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
    U = [float(r["U"]) / float(r.get("k", about.get("k", 2.0))) for r in rows if r.get("U") is not None]
    if "U" in about:
        U.append(float(about["U"]) / float(about.get("k", 2.0)))
    return Artefact(
        id=artefact_id,
        name=name or artefact_id,
        ball_ids=_numbers(labels),
        centres=np.array([[r["x"], r["y"], r["z"]] for r in rows], dtype=float),
        diameters=np.array([r["d"] for r in rows], dtype=float),
        uncertainty_mm=max(U) if U else 0.001,
        reference_temperature_C=float(about.get("T", next((r["T"] for r in rows if r.get("T") is not None), 20.0))),
        expansion_ppm_per_K=_optional(about.get("alpha", next((r["alpha"] for r in rows if r.get("alpha") is not None), None))),
    )


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
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _from_csv(text: str, path: Path) -> tuple[list[Row], Row]:
    lines = [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        return [], {}
    separator = ";" if lines[0][1].count(";") > lines[0][1].count(",") else ","
    header = [_key(h) for h in next(csv.reader([lines[0][1]], delimiter=separator))]
    for needed in NEEDED:
        if needed not in header:
            raise ConfigError(f"{path}:{lines[0][0]}: column '{needed}' is missing; a certificate needs label, x, y, z and d in mm")
    rows = []
    for number, line in lines[1:]:
        cells = next(csv.reader([line], delimiter=separator))
        if len(cells) != len(header):
            raise ConfigError(f"{path}:{number}: {len(cells)} cells under {len(header)} columns; correct the line")
        row: Row = {}
        for key, cell in zip(header, cells, strict=True):
            if key == "label":
                row[key] = cell.strip()
            elif key is not None and cell.strip():
                row[key] = _number(cell.replace(",", ".") if separator == ";" else cell, f"{path}:{number}: column '{key}'")
        if missing := [k for k in NEEDED if row.get(k) in (None, "")]:
            raise ConfigError(f"{path}:{number}: column '{missing[0]}' is empty; correct the line")
        _positive(row, f"{path}:{number}")
        rows.append(row)
    return rows, {}


def _from_yaml(text: str, path: Path) -> tuple[list[Row], Row]:
    data = _mapping(text, path)
    balls = data.get("balls", data.get("spheres"))
    if not isinstance(balls, list):
        raise ConfigError(f"{path}: has no list 'balls' or 'spheres'; give one, with label, x, y, z and diameter of each")
    about = _yaml_about(data, path)
    return [_yaml_row(ball, f"{path}: sphere {i}") for i, ball in enumerate(balls, 1)], about


def _mapping(text: str, path: Path) -> dict[Any, Any]:
    """The mapping in a YAML text, an empty one where the text is something else."""
    try:
        data = yaml12.load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        raise ConfigError(f"{path}:{line}: is not YAML; correct the certificate") from error
    return data if isinstance(data, dict) else {}


def _yaml_about(data: dict[Any, Any], path: Path) -> Row:
    """What holds for all spheres: U, k, T, alpha. Our own artefact files give the standard uncertainty (k = 1) as uncertainty_mm."""
    about: Row = {}
    for key, value in data.items():
        if (known := _key(str(key))) in ("U", "k", "T", "alpha") and value is not None:
            about[known] = _number(value, f"{path}: {key}")
    if data.get("uncertainty_mm") is not None:
        about |= {"U": _number(data["uncertainty_mm"], f"{path}: uncertainty_mm"), "k": 1.0}
    return about


def _yaml_row(ball: Any, where: str) -> Row:
    if not isinstance(ball, dict):
        raise ConfigError(f"{where} is not a mapping; give label, x, y, z and diameter")
    row: Row = {}
    for key, value in ball.items():
        known = _key(str(key))
        if known == "label":
            row[known] = str(value)
        elif known is not None and value is not None:
            row[known] = _number(value, f"{where}: {key}")
    centre = ball.get("centre_mm", ball.get("center_mm"))
    if isinstance(centre, list) and len(centre) == 3:
        row |= {axis: _number(v, f"{where}: centre_mm") for axis, v in zip("xyz", centre, strict=True)}
    if missing := [k for k in NEEDED if k not in row]:
        raise ConfigError(f"{where} has no '{missing[0]}'; a certificate needs label, x, y, z and diameter")
    _positive(row, where)
    return row


def _key(heading: str) -> str | None:
    """Our name of a column: what stands in brackets and a unit at the end are ignored."""
    plain = re.sub(r"[\(\[].*?[\)\]]", "", heading).strip().lower().replace(" ", "_")
    plain = re.sub(r"_(mm|c|degc|ppm_per_k|1e-6_k)$", "", plain)
    return ALIASES.get(plain)


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
