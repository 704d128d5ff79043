"""What a plan can and cannot identify, as findings and as sentences for a terminal."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from mbcacq.calibration.sufficiency import HAND_EYE_ALONE
from mbcacq.design.effect_detectability import Detectability, detectability
from mbcacq.design.options import OPTIONS
from mbcacq.design.planned_scope import PART_ALONE, scans_part
from mbcacq.design.predicted_accuracy import PredictedAccuracy, predicted_accuracy
from mbcacq.design.station_repair import station_moves
from mbcacq.errors import CalibrationError
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.findings import PlanFinding
from mbcacq.plan.routing import Routes, find_paths
from mbcacq.quantities import K, significant, symbol, uncertainty, with_unit

Figures = tuple[list[PlanFinding], PredictedAccuracy | None, Detectability | None]


def identifiability_findings(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], summary: dict[str, Any], routes: Routes | None = None
) -> Figures:
    """Findings about identifiability; the figures behind them, or None where the poses do not suffice to compute them."""
    place = f"{loaded.path}:{loaded.lines.get(('steps',), 1)}"
    if not poses:
        return [], None, None  # nothing is reachable, and ``check_reach`` says so of every target
    useful = [p for p in poses if p.balls]
    if not useful and scans_part(loaded, poses):
        return [PlanFinding(level="info", code="part-alone", step="", place=place, sentence=PART_ALONE)], None, None
    if not any(p.phase != "verification" for p in useful):
        sentence = "there is no pose to calibrate with; add steps of another phase"
        return [PlanFinding(level="warning", code="undetermined", step="", place=place, sentence=sentence)], None, None
    try:
        accuracy = predicted_accuracy(loaded, useful)
    except CalibrationError as error:
        sentence = f"a calibration will refuse these poses: {error}"
        return [PlanFinding(level="warning", code="undetermined", step="", place=place, sentence=sentence)], None, None
    starts = {p["pose"]: p["start_s"] for p in summary["poses"]}
    transits = dict(zip((p.number for p in poses), (routes or find_paths(loaded, poses))[0], strict=True))
    effects = detectability(loaded, useful, [transits[p.number] for p in useful], [starts[p.number] for p in useful])
    return [*_of_accuracy(accuracy, place, OPTIONS.weak_mm), *_of_detectability(effects, place)], accuracy, effects


def reach_findings(loaded: LoadedPlan) -> list[PlanFinding]:
    """The way out for each station with views out of reach."""
    return [
        PlanFinding(level="info", code="move-station", step="", place=f"{loaded.path}:{m.line}", sentence=m.sentence())
        for m in station_moves(loaded)
    ]


def _of_accuracy(accuracy: PredictedAccuracy, place: str, weak_mm: float) -> list[PlanFinding]:
    if accuracy.hand_eye_alone:
        return [PlanFinding(level="info", code="hand-eye-alone", step="", place=place, sentence=HAND_EYE_ALONE)]
    harmful = [u for u in accuracy.undetermined if not u.harmless]
    if harmful:
        names = ", ".join(u.name for u in harmful)
        sentence = f"these poses do not determine {names}; add stations at other places and poses with a larger range of joint angles"
        return [PlanFinding(level="warning", code="undetermined", step="", place=place, sentence=sentence)]
    if accuracy.workspace_mm is not None and accuracy.workspace_mm > weak_mm:
        U = uncertainty(K * accuracy.workspace_mm)
        sentence = (
            f"a point measured anywhere in reach will be uncertain by U = {U} mm (k = 2); add stations "
            "at other places, heights and distances"
        )
        return [PlanFinding(level="warning", code="weak", step="", place=place, sentence=sentence)]
    return []


def _of_detectability(found: Detectability, place: str) -> list[PlanFinding]:
    hidden: dict[str, list[str]] = {}
    for effect in found.effects:
        if not effect.detectable:
            hidden.setdefault(effect.name, []).append(re.sub(r"^(ball|station)(?=\S)", r"\1 ", effect.location))
    if not hidden:
        return []
    listed = "; ".join(f"{name} ({', '.join(sorted(locations))})" for name, locations in hidden.items())
    sentence = f"effects that these poses would not detect at their usual size: {listed}"
    return [PlanFinding(level="info", code="blind", step="", place=place, sentence=sentence)]


def sentences(accuracy: PredictedAccuracy, found: Detectability) -> list[str]:
    """A few lines for a terminal."""
    indices = ", ".join(f"{k} {v:.3g}" for k, v in accuracy.indices.items())
    what = "the hand-eye transform alone" if accuracy.hand_eye_alone else "arm and hand-eye"
    lines = [f"determines {accuracy.determined} of {accuracy.parameters} parameters of {what}; observability {indices}"]
    if accuracy.distance_mm is not None:
        spread = [e for _, e in accuracy.distances]
        parts = f"{_micro(accuracy.calibration_mm)} from the calibration, the rest from measuring them"
        ends = f"{uncertainty(1e3 * K * min(spread))} to {_micro(K * max(spread))}"
        lines.append(
            f"expected error of the certified distances: mean {_micro(accuracy.distance_mm)} ({parts}; U = {ends} by place, k = 2)"
        )
    if accuracy.workspace_mm is not None:
        lines.append(f"expected uncertainty of a point anywhere in reach: U = {_micro(K * accuracy.workspace_mm)} (k = 2, rms)")
    weakest = ", ".join(f"{n} (± {with_unit(uncertainty(K * s), symbol(u))})" for n, s, u in accuracy.weakest)
    lines.append(f"least well determined, ± U (k = 2): {weakest}")
    if accuracy.correlated:
        lines.append("hard to tell apart: " + _pairs(accuracy.correlated))
    detectable = sum(e.detectable for e in found.effects)
    lines.append(f"would detect {detectable} of {len(found.effects)} catalogued effects at their usual size")
    if found.indistinguishable:
        lines.append("effects that look alike here: " + _pairs(found.indistinguishable))
    return lines


def _micro(mm: float | None) -> str:
    """A length that is expected, in µm: two digits."""
    return f"{significant(1e3 * (mm or 0.0), 2)} µm"


def _pairs(correlated: Sequence[tuple[str, str, float]]) -> str:
    return ", ".join(f"{a} / {b} ({c:+.2f})" for a, b, c in correlated[:6])
