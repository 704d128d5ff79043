"""Two recordings of one arm compared: what changed from one campaign to the next, with its uncertainty.

Compared is what each recording alone says, without the prior of the links, which would let every change lean towards zero."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtri

from mbcacq.calibration.result_file import result_of
from mbcacq.calibration.result_io import effects_of, without_prior
from mbcacq.calibration.sufficiency import refuse_other_arm
from mbcacq.errors import ConfigError
from mbcacq.exports.result_json import load_result
from mbcacq.geometry import se3
from mbcacq.model.cell import RobotModel
from mbcacq.model.json_text import damage
from mbcacq.quantities import K, in_degrees
from mbcacq.report.several import FALSE_ALARMS, Change, RunComparison, Together
from mbcacq.report.sources.coefficients import names_in_words

TURNS = {"rad": in_degrees(1.0)}  # angles are shown in degrees
DETERMINED = {"free", "prior"}
REGULAR = 1e-12  # least eigenvalue of the normalised covariance of all changes that counts as known


def compare_runs(first: Path | str, second: Path | str) -> RunComparison:
    """Compare the calibrations of two recordings of one arm: a run folder each (with its effects, where ``diagnose --calibrate`` made
    such a result), or a result.json.

    Raises ConfigError where one has no result, or they are of different arms.
    """
    if Path(first).resolve() == Path(second).resolve():
        raise ConfigError(f"{first} is the same recording as {second}: nothing can have changed; give two recordings")
    results = [best_result(Path(path)) for path in (first, second)]
    return compare_results(results[0], results[1], (str(first), str(second)))


def compare_results(first: Mapping[str, Any], second: Mapping[str, Any], names: tuple[str, str] = ("first", "second")) -> RunComparison:
    """Compare the contents of two result.json. Raises ConfigError where they are of different arms, or one is damaged."""
    one, two = (result_of(result, f"the {which} result").robot for result, which in ((first, "first"), (second, "second")))
    robot, axes = one.name, len(two.sign)
    other = RobotModel(two.name, two.nominal_chain, np.zeros(axes), np.zeros(axes), np.zeros((1, 3)))
    refuse_other_arm("the first recording is of", robot, one.nominal_chain, other, "the second")
    try:
        changes, covariance, leaning = _geometry(first, second)
        rows = [*changes, *_effects(first, second)]
        figures = _figures(first, second)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"one of the results is damaged ({damage(error)}); write it anew with mbcacq calibrate") from error
    tested = sum(row.change is not None and row.change[1] is not None for row in rows)
    limit = float(-ndtri(FALSE_ALARMS / 2 / max(tested, 1)))
    rows = [_judged(row, limit) for row in rows]
    chi2, dof = _together([row.change[0] for row in changes if row.change is not None], covariance)
    return RunComparison(
        names=names,
        robot=robot,
        rows=(*rows, *figures),
        together=Together(chi2=chi2, dof=dof, p_value=float(chdtrc(dof, chi2)) if dof else 1.0),
        leaning=leaning,
    )


def best_result(path: Path) -> dict[str, Any]:
    """The best result of a run: with effects, where there is one."""
    with_effects = path / "with-effects" / "result.json"
    return load_result(with_effects if with_effects.is_file() else path)


def _geometry(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[list[Change], np.ndarray, bool]:
    """Rows of arm and hand-eye; the covariance (c, c) of the changes that both recordings determine, in their order and units; whether
    these lean towards zero."""
    listed = [{p["name"]: p for p in result["parameters"]} for result in (first, second)]
    own = [without_prior(result) for result in (first, second)]
    T = se3.inverse(own[0].T_flange_scanner) @ own[1].T_flange_scanner
    moved = dict(zip(("x", "y", "z", "rx", "ry", "rz"), se3.coordinates(T), strict=True))
    rows: list[Change] = []
    common: list[tuple[str, float]] = []
    for name, one in listed[0].items():
        two = listed[1].get(name)
        mount = name.removeprefix("hand_eye.") if name.startswith("hand_eye.") else ""
        what = "hand-eye" if mount else "effect" if name.startswith("unknown:") else "parameter"
        named_effect = ":" in name and not name.startswith("unknown:")  # has a row of its own below
        if two is None or name.startswith("ball_") or named_effect or not {one["status"], two["status"]} & DETERMINED:
            continue
        scale = TURNS.get(one["unit"], 1.0)
        unit = "deg" if one["unit"] in TURNS else one["unit"]
        before, after = (
            None if mount or p["std"] is None else (scale * each.error[name], K * scale * each.std(name))
            for p, each in zip((one, two), own, strict=True)
        )
        if one["std"] is None or two["std"] is None:
            held = "first" if one["std"] is None else "second"
            rows.append(Change(what, name, unit, before, after, None, why_not=f"held in the {held}"))
            continue
        value = moved[mount] if mount else own[1].error[name] - own[0].error[name]
        change = (scale * value, K * scale * float(np.hypot(own[0].std(name), own[1].std(name))))
        rows.append(Change(what, name, unit, before, after, change))
        common.append((name, scale))
    covariance = np.zeros((len(common), len(common)))
    for each in own:
        at = [each.names.index(name) for name, _ in common]
        covariance += each.covariance[np.ix_(at, at)]
    scales = np.array([scale for _, scale in common])
    return rows, covariance * scales[:, None] * scales, not all(each.known for each in own)


def _together(changes: list[float], covariance: np.ndarray) -> tuple[float, int]:
    """Chi2 of all changes against none, and its degrees of freedom; combinations that no recording determines are left out."""
    if not changes:
        return 0.0, 0
    sigma = np.sqrt(np.diag(covariance))
    value, vector = np.linalg.eigh(covariance / sigma / sigma[:, None])
    known = value > REGULAR * value[-1]
    along = vector[:, known].T @ (np.array(changes) / sigma)
    return float(np.sum(along**2 / value[known])), int(known.sum())


def _effects(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[Change]:
    models = [effects_of(result) for result in (first, second)]
    terms = [{} if model is None else {term.key: term for term in model.terms if term.name != "unknown"} for model in models]
    rows = []
    for key in dict.fromkeys([*terms[0], *terms[1]]):
        one, two = (found.get(key) for found in terms)
        term = one or two
        assert term is not None, "the key is of one of them"
        for k, name in enumerate(names_in_words(term.names)):
            before, after = (None if t is None else (float(t.coefficients[k]), K * float(t.std[k])) for t in (one, two))
            change = None
            if before is not None and after is not None:
                change = (after[0] - before[0], float(np.hypot(before[1], after[1])))
            lacking = "" if change is not None else f"not found in the {'first' if one is None else 'second'}"
            rows.append(Change("effect", name, term.units[k], before, after, change, why_not=lacking))
    return rows


def _figures(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[Change]:
    """Rows that describe the recordings themselves; none of them is judged."""
    rows = []
    for name, keys in (
        ("residual, 3D rms", ("fit", "rms_mm")),
        ("largest sphere spacing error", ("verification", "after", "max_mm")),
        ("mean sphere spacing error", ("verification", "after", "mean_mm")),
    ):
        values = [_inside(result, keys) for result in (first, second)]
        if any(v is not None for v in values):
            before, after = (None if v is None else (v, None) for v in values)
            change = None if before is None or after is None else (after[0] - before[0], None)
            rows.append(Change("figure", name, "mm", before, after, change))
    for axis in range(3):
        before, after = ((float(result["noise"]["scanner_mm"][axis]), None) for result in (first, second))
        rows.append(Change("figure", f"scanner noise (k = 1), {'xyz'[axis]}", "mm", before, after, (after[0] - before[0], None)))
    return rows


def _inside(content: Mapping[str, Any], keys: tuple[str, ...]) -> float | None:
    value: Any = content
    for key in keys:
        value = (value or {}).get(key)
    return None if value is None else float(value)


def _judged(row: Change, limit: float) -> Change:
    if row.change is None or not row.change[1]:
        return row
    return replace(row, significant=bool(abs(row.change[0]) > limit * row.change[1] / K))
