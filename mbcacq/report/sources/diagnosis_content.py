"""A diagnosis as the report tells it: its JSON and what its pictures need, as plain values in words and units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbcacq.report.verdict import readable

VERDICTS = {
    "none": ("pass", "No effect found", "The simulation explains the recording down to the measured noise."),
    "explained": ("found", "Explained", "The effects below bring the simulation down to the measured noise."),
    "partly_explained": ("found", "Partly explained", "The effects below help, but structure remains."),
    "unexplained": ("fail", "Unexplained", "There is a mismatch that no effect of the catalogue describes."),
    "cannot_tell": ("none", "Cannot tell", "These poses do not let the candidates be told apart, or be seen."),
}
UNITS = {
    "rad_per_Nm": "µrad/(N m)",
    "mm_per_K": "mm/K",
    "um": "µm",
    "urad": "µrad",
    "deg": "deg",
    "mm": "mm",
    "rad": "rad",
    "ppm": "ppm",
    "ppm_per_K": "ppm/K",
    "s": "s",
    "kg": "kg",
    "K": "K",
}


@dataclass(frozen=True)
class EffectContent:
    """parameters: (name, value, standard deviation, unit) as texts; alternatives: sentences."""

    title: str
    depends_on: str
    p_value: str
    gain: str
    parameters: list[tuple[str, str, str, str]]
    alternatives: list[str]


@dataclass(frozen=True)
class DiagnosisContent:
    """map: (places, covariates, (a, c) strengths, NaN where nothing was tested); curves, causes, centres as in the pictures' file."""

    level: str
    headline: str
    reason: str
    effects: list[EffectContent] = field(default_factory=list)
    mismatch: list[tuple[str, str, str]] = field(default_factory=list)
    proof: list[tuple[str, str, str, str]] = field(default_factory=list)
    floor: str = ""
    sentences: list[str] = field(default_factory=list)
    map: tuple[list[str], list[str], np.ndarray] | None = None
    curves: list[Mapping[str, Any]] = field(default_factory=list)
    causes: list[Mapping[str, Any]] = field(default_factory=list)
    centres: Mapping[str, Any] | None = None


def diagnosis_content(diagnosis: Mapping[str, Any], pictures: Mapping[str, Any] | None) -> DiagnosisContent:
    """Raises KeyError or TypeError where the diagnosis is damaged. Pictures that are damaged are left out."""
    if pictures is not None and not _whole(pictures):
        pictures = None
    from mbcacq.diagnosis.output.figures import axis_of

    level, headline, reason = VERDICTS.get(diagnosis["verdict"], ("none", readable(diagnosis["verdict"]), ""))
    fit = diagnosis["fit"]
    proof = [
        (label, *(f"{1e3 * fit[key][f'{when}_rms_mm']:.1f} µm (χ²/dof {fit[key][f'{when}_chi2_dof']:.2f})" for when in ("before", "after")))
        for key, label in (("train", "data fitted"), ("held_out", f"data that took no part (by {fit['held_out']['split']})"))
    ]
    sentences = [
        f"Cannot be told apart: {' and '.join(p['effects'])} (correlation {p['correlation']:.2f})."
        for p in diagnosis.get("not_separable", ())
    ]
    sentences += [f"Measure next: {a['reason']}" for a in diagnosis.get("advice", ())]
    sentences += [f"{note[:1].upper()}{note[1:]}." for note in diagnosis.get("notes", ())]
    return DiagnosisContent(
        level,
        headline,
        reason,
        [_effect(e, axis_of) for e in diagnosis["effects"]],
        [(m["at"], axis_of(m["depends_on"])[0], _share(m["share"])) for m in diagnosis["mismatch"]],
        proof,
        f"{1e3 * fit['repeatability_floor_mm']:.1f} µm",
        sentences,
        *((_map(pictures["map"], axis_of), pictures["curves"], pictures["causes"], pictures["centres"]) if pictures else ()),
    )


def _whole(pictures: Mapping[str, Any]) -> bool:
    """Whether everything is there that is drawn, in equal numbers."""
    try:
        rows = len(pictures["centres"]["pose"])
        even = [len(pictures["centres"][name]) == rows for name in ("before_mm", "after_mm")]
        even += [len(cause["values"]) == rows and isinstance(cause["label"] + cause["unit"], str) for cause in pictures["causes"]]
        for curve in pictures["curves"]:
            even += [len(curve[name]) == len(curve["x"]) for name in ("y", "std", "seen")]
            even.append(all(isinstance(curve[name], str) for name in ("effect", "at", "what", "unit", "x_label", "x_unit")))
        even += [isinstance(spot["at"] + spot["depends_on"], str) and float(spot["strength"]) >= 0 for spot in pictures["map"]]
    except (KeyError, TypeError, ValueError, AttributeError):
        return False
    return all(even)


def _effect(effect: Mapping[str, Any], axis_of: Any) -> EffectContent:
    name = "an effect without a name" if effect["name"] == "unknown" else readable(effect["name"])
    alternatives = [
        f"{readable(a['name'])} at {', '.join(a['where'])} (would remove {a['held_out_gain']:.0%})" for a in effect["alternatives"]
    ]
    return EffectContent(
        f"{name[0].upper()}{name[1:]} at {', '.join(effect['where'])}",
        axis_of(effect["depends_on"])[0] if effect.get("depends_on") else "",
        "below 1e-12" if effect["p_value"] < 1e-12 else f"about {effect['p_value']:.1g}",
        _share(effect["held_out_gain"]),
        [row for key, entry in effect["parameters"].items() for row in _parameter(key, entry)][:40],
        alternatives,
    )


def _parameter(key: str, entry: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    name, unit = split_unit(key)
    factor = 1e6 if key.endswith("rad_per_Nm") else 1.0
    listed = [v if isinstance(v, list) else [v] for v in (entry["value"], entry["std"])]
    values, stds = ([None if x is None else factor * x for x in v] for v in listed)
    return [
        (f"{name} [{k + 1}]" if len(values) > 1 else name, _number(v, s), _number(s, s), unit)
        for k, (v, s) in enumerate(zip(values, stds, strict=False))
    ]


def split_unit(key: str) -> tuple[str, str]:
    """'A2.compliance_rad_per_Nm' -> 'A2 compliance', 'rad/(N m)'."""
    for ending in sorted(UNITS, key=len, reverse=True):
        if key.endswith("_" + ending):
            return readable(key[: -len(ending) - 1].replace(".", " ")), UNITS[ending]
    return readable(key.replace(".", " ")), ""


def _share(value: float) -> str:
    return "below 1%" if 0 < value < 0.005 else f"{value:.0%}"


def _number(value: float | None, std: float | None) -> str:
    """As many digits as the uncertainty justifies: two of its own."""
    if value is None or not np.isfinite(value):
        return "–"
    if not std or not np.isfinite(std) or value == 0:
        return f"{value:.4g}".replace("-", "−")
    digits = int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(std)) + 2, 2, 8)) if abs(value) >= std else 2
    return f"{value:.{digits}g}".replace("-", "−")


def _map(spots: list[Mapping[str, Any]], axis_of: Any) -> tuple[list[str], list[str], np.ndarray] | None:
    """The strongest of each place and covariate; covariates that nothing depends on at all stay, so that the map shows what was tried."""
    if not spots:
        return None
    at = sorted({s["at"] for s in spots}, key=_natural)
    on = sorted({s["depends_on"] for s in spots}, key=_natural)
    z = np.full((len(at), len(on)), np.nan)
    for s in spots:
        i, j = at.index(s["at"]), on.index(s["depends_on"])
        z[i, j] = np.nanmax([z[i, j], s["strength"]])
    return at, [axis_of(o)[0] for o in on], z


def _natural(name: str) -> tuple[int, str, int]:
    """Joints, links, base, mount, scanner, balls, stations; each by number."""
    stem = name.rstrip("0123456789")
    order = ["q", "gravity_torque_", "direction_", "time", "pose", "A", "link", "base", "mount", "scanner", "ball", "station"]
    number = name[len(stem) :]
    rank = next((k for k, o in enumerate(order) if stem.startswith(o)), len(order)) if stem not in order else order.index(stem)
    return rank, stem, int(number) if number else 0
