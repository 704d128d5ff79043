"""The JSON of a diagnosis and of its pictures to the content of a report: plain values in words and units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.output.noise_floor import NoiseFloor
from mbcacq.effects.in_words import effect_in_words, odds_in_words
from mbcacq.effects.trend import components, trend_in_json
from mbcacq.model.json_text import from_fields
from mbcacq.quantities import K, fixed, micrometres, p_value, pair, percent, split_unit
from mbcacq.report.content import DiagnosisContent, EffectContent, TrialContent
from mbcacq.report.verdict import readable

TRIED = ["what is left there (3D)", "rms", "median", "χ²/dof, noise as learnt"]
VERDICTS = {
    "none": ("pass", "No effect found", "The model explains the data {distance}."),
    "explained": ("found", "Explained", "With the effects below the model explains the data {distance}."),
    "partly_explained": ("found", "Partly explained", "The effects below help, but residual structure remains."),
    "unexplained": ("fail", "Unexplained", "There is a mismatch that no effect of the catalogue describes."),
    "cannot_tell": ("none", "Cannot tell", "From these poses the candidates cannot be separated or detected."),
}


def diagnosis_content(diagnosis: Mapping[str, Any], pictures: Mapping[str, Any] | None) -> DiagnosisContent:
    """Content of a diagnosis; damaged pictures are left out. Raises KeyError, TypeError or ValueError where the diagnosis itself is
    damaged."""
    if pictures is not None and not _complete(pictures):
        pictures = None
    from mbcacq.diagnosis.output.pictures import axis_of

    level, headline, reason = VERDICTS.get(diagnosis["verdict"], ("none", readable(diagnosis["verdict"]), ""))
    fit = diagnosis["fit"]
    centres = sum(int(g.get("centres", 0)) for g in diagnosis.get("geometry_alone", ()))
    floor = NoiseFloor.of(fit["held_out"]["after_rms_mm"], fit["repeatability_floor_mm"], centres)
    validation = [
        (label, _misfit(fit[key], "before"), _misfit(fit[key], "after"))
        for key, label in (("train", "data fitted"), ("held_out", f"held-out data (by {fit['held_out']['split']})"))
    ]
    remarks = [*open_remarks(diagnosis), *(f"{_note(note)}." for note in diagnosis.get("notes", ()))]
    return DiagnosisContent(
        level=level,
        headline=headline,
        reason=reason.format(distance=floor.distance),
        effects=sorted((effect_content(e) for e in diagnosis["effects"]), key=lambda e: bool(e.trend)),
        mismatch=[(m["at"], axis_of(m["depends_on"])[0], percent(m["share"])) for m in diagnosis["mismatch"]],
        validation=validation,
        noise_floor=floor.noise,
        trials=[trial_content(from_fields(Transfer, one)) for one in diagnosis.get("checks", ())],
        remarks=remarks,
        **({} if pictures is None else _drawn(pictures, axis_of)),
    )


def _misfit(fit: Mapping[str, float], when: str) -> str:
    return f"{micrometres(fit[f'{when}_rms_mm'])} (χ²/dof {fit[f'{when}_chi2_dof']:.2f})"


def trial_content(tried: Transfer) -> TrialContent:
    """What was found in a diagnosis of poses, tried on another recording."""
    placed = "base, tool and stations fitted" if tried.place == "fitted" else "nothing fitted"
    figures = {
        "the learnt geometry alone": tried.geometry_alone,
        "with its effects": tried.with_effects,
        "a geometry fitted there": tried.own_geometry,
    }
    if left := tried.parts_left_out:
        figures |= {"with effects, parts left out of the fit": left.as_learnt, "and what was not to be learnt drawn anew": left.drawn_anew}
    rows = [(label, micrometres(of.rms_mm), micrometres(of.median_mm), fixed(of.chi2_dof, 2)) for label, of in figures.items() if of]
    rows += [(f"without {_effect_name(e.name)} at {', '.join(e.where)}", micrometres(e.without_mm), "", "") for e in tried.effects]
    notes = [f"{tried.poses} poses, {placed}."]
    if tried.normalised_error:
        notes.append(f"Error over stated uncertainty: {tried.normalised_error.in_words}.")
    notes += [f"{one}." for one in tried.warnings]
    return TrialContent(recording=tried.recording or "another recording", heads=TRIED, rows=rows, notes=notes)


def _drawn(pictures: Mapping[str, Any], axis_of: Any) -> dict[str, Any]:
    """Fields of DiagnosisContent that its figures are drawn from."""
    return {
        "evidence_map": _map(pictures["map"], axis_of),
        "curves": pictures["curves"],
        "covariates": pictures["causes"],
        "centres": pictures["centres"],
    }


def _complete(pictures: Mapping[str, Any]) -> bool:
    """Whether everything is there that is drawn, in equal numbers."""
    try:
        rows = len(pictures["centres"]["pose"])
        even = [len(pictures["centres"][name]) == rows for name in ("before_mm", "after_mm")]
        even += [len(cause["values"]) == rows and isinstance(cause["label"] + cause["unit"], str) for cause in pictures["causes"]]
        for curve in pictures["curves"]:
            even += [len(curve[name]) == len(curve["x"]) for name in ("y", "std", "seen")]
            even.append(all(isinstance(curve[name], str) for name in ("effect", "at", "what", "unit", "x_label", "x_unit")))
        even += [isinstance(f["at"] + f["depends_on"], str) and float(f["strength"]) >= 0 for f in pictures["map"]]
    except (KeyError, TypeError, ValueError, AttributeError):
        return False
    return all(even)


def effect_content(effect: Mapping[str, Any]) -> EffectContent:
    """An effect of a diagnosis of poses or of motion, from its JSON."""
    from mbcacq.diagnosis.output.pictures import axis_of

    name = _effect_name(effect["name"])
    alternatives = [f"{_effect_name(a['name'])} at {', '.join(a['where'])} ({_likelihood(a)})" for a in effect["alternatives"]]
    trend = trend_in_json(effect)
    shown = {} if trend else effect["parameters"]
    return EffectContent(
        title=f"{'Trend: ' if trend else ''}{name if trend else name[0].upper() + name[1:]} at {', '.join(effect['where'])}",
        depends_on=axis_of(effect["depends_on"])[0] if effect.get("depends_on") else "",
        p_value=p_value(effect["p_value"]),
        gain=percent(effect["held_out_gain"]),
        parameters=[row for key, entry in shown.items() if not _of_harmonics(key, entry) for row in _parameter(key, entry)],
        alternatives=alternatives,
        harmonics=_harmonics({key: entry for key, entry in shown.items() if _of_harmonics(key, entry)}),
        trend=trend,
    )


def open_remarks(diagnosis: Mapping[str, Any]) -> list[str]:
    """What cannot be told apart, and what to measure next, of a diagnosis of poses or of motion."""
    remarks = []
    for one in diagnosis.get("not_separable", ()):
        odds = "" if one.get("odds") is None else f", {odds_in_words(one['odds'])}"
        both = " and ".join(map(effect_in_words, one["effects"]))
        remarks.append(f"Not separable: {both} (correlation {one['correlation']:.2f}{odds}).")
    return remarks + [f"Measure next: {a['reason'].removesuffix('.')}." for a in diagnosis.get("advice", ())]


def _note(note: str) -> str:
    """A note as a sentence; the name of an effect at its begin becomes words."""
    first, space, rest = note.partition(" ")
    first = readable(first)
    return f"{first[:1].upper()}{first[1:]}{space}{rest}"


def _effect_name(name: str) -> str:
    return "an unmodelled effect" if name == "unknown" else readable(name)


def _likelihood(alternative: Mapping[str, Any]) -> str:
    """How probable an alternative is against what was selected; the share of the mismatch that it would remove where only that is known."""
    odds = alternative.get("odds")
    if odds is None:
        return f"would remove {percent(alternative['held_out_gain'])}"
    return odds_in_words(odds)


def _is_vector(key: str, entry: Mapping[str, Any]) -> bool:
    """Whether the values are components along x, y and z."""
    return (key.endswith("_mm") or key.startswith("rotation_")) and isinstance(entry["value"], list) and len(entry["value"]) == 3


def _of_harmonics(key: str, entry: Mapping[str, Any]) -> bool:
    return isinstance(entry["value"], list) and len(entry["value"]) > 1 and not _is_vector(key, entry)


def _harmonics(parameters: Mapping[str, Mapping[str, Any]]) -> tuple[list[str], list[list[str]]] | None:
    """A column for each parameter that has several values, a row for each of them (a harmonic); as many rows as the longest has."""
    heads, columns = [], []
    for key, entry in parameters.items():
        rows = _parameter(key, entry)
        unit = rows[0][3]
        heads.append(split_unit(key)[0] + (f" / {unit}" if unit else ""))
        columns.append([f"{value} ± {uncertainty}" for _, value, uncertainty, _ in rows])
    if not columns:
        return None
    count = max(len(column) for column in columns)
    return heads, [[column[k] if k < len(column) else "" for column in columns] for k in range(count)]


def _parameter(key: str, entry: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    name, unit, factor = split_unit(key)
    values, stds = ([None if x is None else factor * x for x in v] for v in components(entry))
    return [
        (
            f"{name} {'xyz'[k] if _is_vector(key, entry) else f'[{k + 1}]'}" if len(values) > 1 else name,
            *pair(v, None if s is None else K * s),
            unit,
        )
        for k, (v, s) in enumerate(zip(values, stds, strict=False))
    ]


def _map(fields: list[Mapping[str, Any]], axis_of: Any) -> tuple[list[str], list[str], np.ndarray] | None:
    """The largest strength of each location and covariate. Covariates without any evidence stay, so that the map shows what was tested."""
    if not fields:
        return None
    locations = sorted({f["at"] for f in fields}, key=_natural)
    covariates = sorted({f["depends_on"] for f in fields}, key=_natural)
    z = np.full((len(locations), len(covariates)), np.nan)
    for f in fields:
        i, j = locations.index(f["at"]), covariates.index(f["depends_on"])
        z[i, j] = np.nanmax([z[i, j], f["strength"]])
    return locations, [axis_of(c)[0] for c in covariates], z


def _natural(name: str) -> tuple[int, str, int]:
    """Sort key: joints, links, base, mount, scanner, balls, stations, each by number."""
    stem = name.rstrip("0123456789")
    order = ["q", "gravity_torque_", "direction_", "time", "pose", "A", "link", "base", "mount", "scanner", "ball", "station"]
    number = name[len(stem) :]
    rank = next((k for k, o in enumerate(order) if stem.startswith(o)), len(order)) if stem not in order else order.index(stem)
    return rank, stem, int(number) if number else 0
