"""A diagnosis to the content of a report, that of poses with its pictures: plain values in words and units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.findings import Findings
from mbcacq.diagnosis.output.noise_floor import NoiseFloor
from mbcacq.diagnosis.output.pictures import axis_of
from mbcacq.diagnosis.output.repetition import sentences
from mbcacq.diagnosis.output.text import difference, first_sentence, likelihood, noise_floor, open_lines, size_of_shape
from mbcacq.diagnosis.result import Diagnosis, FitFigures, HeldOutFigures
from mbcacq.effects.effect import ParameterEstimate, Parameters
from mbcacq.effects.in_words import CHANNELS, spelt_out
from mbcacq.quantities import K, capitalised, fixed, micrometres, p_value, pair, percent, split_unit
from mbcacq.report.content import DiagnosisContent, EffectContent, TrialContent
from mbcacq.report.verdict import readable

TRIED = ["what is left there (3D)", "rms", "median", "χ²/dof, noise as learnt"]
LEVELS = {"none": "pass", "explained": "found", "partly_explained": "found", "unexplained": "fail", "cannot_tell": "none"}
OF_CHANNELS = {"tau": "the torque", "q_joint": "the joint-side angle", "q_set": "the set point"}  # all joints of a channel as a location


def diagnosis_content(found: Diagnosis, pictures: Mapping[str, Any] | None, checks: Iterable[Transfer] = ()) -> DiagnosisContent:
    """Content of a diagnosis of poses; damaged pictures are left out. checks: what was found, tried on other recordings."""
    fit, floor = found.fit, noise_floor(found)
    each = (("data fitted", fit.train), (f"held-out data (by {fit.held_out.split})", fit.held_out))
    return DiagnosisContent(
        **what_every_diagnosis_says(found, floor, floor.is_excess(fit.held_out.before_chi2_dof)),
        mismatch=mismatch_rows(found),
        validation=[(label, *_misfits(figures)) for label, figures in each] + _of_every_centre(fit.held_out),
        noise_floor=floor.noise,
        trials=list(map(trial_content, checks)),
        remarks=[
            *open_remarks(found),
            *(f"{difference(one)}." for one in found.between_recordings),
            *(f"{_note(note)}." for note in found.notes),
        ],
        **(_drawn(pictures) if pictures is not None and _complete(pictures) else {}),
    )


def what_every_diagnosis_says(found: Findings, floor: NoiseFloor | None = None, excess: bool = True) -> dict[str, Any]:
    """Fields of DiagnosisContent: verdict and effects, the findings before the trends. excess: of held-out data, of which effects remove a
    share.
    """
    headline, _, reason = first_sentence(found, floor).partition(": ")
    effects = sorted((effect_content(e, excess) for e in found.effects), key=lambda e: bool(e.trend))
    return {"level": LEVELS[found.verdict], "headline": headline, "reason": capitalised(reason), "effects": effects}


def mismatch_rows(found: Findings, least_share: float = 0.0) -> list[tuple[str, str, str, str]]:
    """What depends on what, with its share of the excess; none below the least one."""
    return [
        (OF_CHANNELS.get(m.at, m.at), CHANNELS.get(m.channel, ""), axis_of(m.depends_on)[0], percent(m.share))
        for m in found.mismatch
        if not m.share < least_share
    ]


def _misfits(fit: FitFigures) -> tuple[str, str]:
    """3D rms with chi2 per degree of freedom, before and after."""
    each = (fit.before_rms_mm, fit.before_chi2_dof), (fit.after_rms_mm, fit.after_chi2_dof)
    before, after = (f"{micrometres(rms)} (χ²/dof {chi2_dof:.2f})" for rms, chi2_dof in each)
    return before, after


def _of_every_centre(held: HeldOutFigures) -> list[tuple[str, str, str]]:
    """A row of all held-out centres, where the other one is robust."""
    if not held.rejects:
        return []
    label = f"all {held.centres} held-out centres; above {held.robust_centres} of them, robust"
    return [(label, micrometres(held.every_before_rms_mm), micrometres(held.every_after_rms_mm))]


def trial_content(tried: Transfer) -> TrialContent:
    """What was found in a diagnosis of poses, tried on another recording."""
    figures = {
        "the learnt geometry alone": tried.geometry_alone,
        "with its effects": tried.with_effects,
        "a geometry fitted there": tried.own_geometry,
    }
    if left := tried.parts_left_out:
        figures |= {"with effects, parts left out of the fit": left.as_learnt, "and what was not to be learnt drawn anew": left.drawn_anew}
    rows = [(label, micrometres(of.rms_mm), micrometres(of.median_mm), fixed(of.chi2_dof, 2)) for label, of in figures.items() if of]
    rows += [(f"without {spelt_out(e.name)} at {', '.join(e.where)}", micrometres(e.without_mm), "", "") for e in tried.effects]
    notes = [f"{capitalised(tried.tried_on)}."]
    if tried.normalised_error:
        notes.append(f"Error over stated uncertainty: {tried.normalised_error.in_words}.")
    notes += [f"{one}." for one in tried.warnings]
    return TrialContent(recording=tried.recording or "another recording", heads=TRIED, rows=rows, notes=notes)


def _drawn(pictures: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of DiagnosisContent that its figures are drawn from."""
    return {
        "evidence_map": _map(pictures["map"]),
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


def effect_content(effect: EffectFound, excess: bool = True) -> EffectContent:
    """An effect of a diagnosis of poses or of motion; an unmodelled one of a motion has a size in place of parameters."""
    name, trend = spelt_out(effect.name), effect.trend
    at = ", ".join(OF_CHANNELS.get(where, where) for where in effect.where)
    shown = {} if trend else effect.parameters
    harmonics = _of_harmonics(shown)
    notes = [] if effect.shape is None else [f"{capitalised(size_of_shape(effect, effect.shape))}."]
    notes += [f"{split_unit(first)[0]} {rest}." for first, _, rest in (note.partition(" ") for note in sentences(effect))]
    return EffectContent(
        title=f"Trend: {name} at {at}" if trend else f"{capitalised(name)} at {at}",
        depends_on=axis_of(effect.depends_on)[0] if effect.depends_on else "",
        p_value=p_value(effect.p_value),
        gain=percent(effect.gain_here) if excess and effect.removes else "",
        parameters=[row for key, entry in shown.items() if key not in harmonics for row in _parameter(key, entry)],
        alternatives=[f"{spelt_out(a.name)} at {', '.join(a.where)} ({likelihood(a)})" for a in effect.alternatives],
        harmonics=_harmonics(harmonics),
        trend=trend,
        notes=notes,
    )


def open_remarks(found: Findings) -> list[str]:
    """What cannot be told apart, and what to measure next."""
    return [f"{line.removesuffix('.')}." for line in open_lines(found.not_separable, found.advice)]


def _note(note: str) -> str:
    """A note as a sentence; the name of an effect at its begin becomes words."""
    first, space, rest = note.partition(" ")
    first = readable(first)
    return f"{capitalised(first)}{space}{rest}"


def _is_vector(key: str, entry: ParameterEstimate) -> bool:
    """Whether the values are components along x, y and z."""
    return (key.endswith("_mm") or key.startswith(("rotation_", "scale_"))) and len(entry.components[0]) == 3


def _of_harmonics(parameters: Parameters) -> Parameters:
    """Those of several orders of a joint. Values of several breakpoints or recordings are no harmonics."""
    several = {key: entry for key, entry in parameters.items() if len(entry.components[0]) > 1 and not _is_vector(key, entry)}
    return several if any(key.rpartition(".")[2] == "order" for key in several) else {}


def _harmonics(parameters: Parameters) -> tuple[list[str], list[list[str]]] | None:
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


def _parameter(key: str, entry: ParameterEstimate) -> list[tuple[str, str, str, str]]:
    name, unit, factor = split_unit(key)
    values, stds = entry.components
    return [
        (
            f"{name} {'xyz'[k] if _is_vector(key, entry) else f'[{k + 1}]'}" if len(values) > 1 else name,
            *pair(factor * v, K * factor * s),
            unit,
        )
        for k, (v, s) in enumerate(zip(values, stds, strict=True))
    ]


def _map(fields: list[Mapping[str, Any]]) -> tuple[list[str], list[str], np.ndarray] | None:
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
    order = ["q", "gravity_torque_", "direction_", "time", "pose", "s", "E", "A", "link", "base", "mount", "scanner", "ball", "station"]
    number = name[len(stem) :]
    rank = next((k for k, o in enumerate(order) if stem.startswith(o)), len(order)) if stem not in order else order.index(stem)
    return rank, stem, int(number) if number else 0
