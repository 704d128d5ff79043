"""What a plan can and cannot see, as findings and as plain words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mbcacq.design.effect_detectability import Detectability, visibility
from mbcacq.design.expected_accuracy import ExpectedAccuracy, prospect
from mbcacq.errors import CalibrationError
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.findings import PlanFinding
from mbcacq.plan.routing import Routes, find_paths

WEAK_MM = 0.1  # uncertainty of a point somewhere in reach that deserves a warning
Figures = tuple[list[PlanFinding], ExpectedAccuracy | None, Detectability | None]


def insight(loaded: LoadedPlan, poses: Sequence[PlannedPose], summary: dict[str, Any], routes: Routes | None = None) -> Figures:
    """Findings about identifiability; the figures behind them, or None where the poses do not suffice to compute them."""
    place = f"{loaded.path}:{loaded.lines.get(('steps',), 1)}"
    seeing = [p for p in poses if p.balls]
    if not any(p.phase != "verification" for p in seeing):
        return (
            [PlanFinding("warning", "undetermined", "", place, "there is no pose to calibrate with; add steps of another phase")],
            None,
            None,
        )
    try:
        outlook = prospect(loaded, seeing)
    except CalibrationError as error:
        return [PlanFinding("warning", "undetermined", "", place, str(error))], None, None
    starts = {p["pose"]: p["start_s"] for p in summary["poses"]}
    transits = dict(zip((p.number for p in poses), (routes or find_paths(loaded, poses))[0], strict=True))
    sight = visibility(loaded, seeing, [transits[p.number] for p in seeing], [starts[p.number] for p in seeing])
    return [*_of_prospect(outlook, place), *_of_sight(sight, place)], outlook, sight


def _of_prospect(outlook: ExpectedAccuracy, place: str) -> list[PlanFinding]:
    out = []
    harmful = [u for u in outlook.undetermined if not u.harmless]
    if harmful:
        names = ", ".join(u.name for u in harmful)
        sentence = f"these poses do not determine {names}; add stations at other places and poses with a larger range of joint angles"
        out.append(PlanFinding("warning", "undetermined", "", place, sentence))
    elif outlook.workspace_mm is not None and outlook.workspace_mm > WEAK_MM:
        sentence = (
            f"a point measured anywhere in reach will be uncertain by {outlook.workspace_mm:.2f} mm; add stations at other places, "
            f"heights and distances"
        )
        out.append(PlanFinding("warning", "weak", "", place, sentence))
    return out


def _of_sight(sight: Detectability, place: str) -> list[PlanFinding]:
    blind = {}
    for effect in sight.effects:
        if not effect.seen:
            blind.setdefault(effect.name, []).append(effect.where)
    if not blind:
        return []
    listed = "; ".join(f"{name} ({', '.join(sorted(where))})" for name, where in blind.items())
    return [PlanFinding("info", "blind", "", place, f"effects that these poses would not show at their usual size: {listed}")]


def words(outlook: ExpectedAccuracy, sight: Detectability) -> list[str]:
    """A few lines for a terminal."""
    o = outlook.indices
    lines = [
        f"determines {outlook.determined} of {outlook.parameters} parameters of arm and hand-eye; observability "
        + ", ".join(f"{k} {v:.3g}" for k, v in o.items())
    ]
    if outlook.bar_mm is not None:
        spread = [e for _, e in outlook.places]
        parts = f"{outlook.bar_cell_mm:.4f} mm from the calibration, the rest from measuring them"
        lines.append(
            f"expected error of the certified distances: mean {outlook.bar_mm:.4f} mm ({parts}; standard uncertainty "
            f"{min(spread):.4f} to {max(spread):.4f} mm by place)"
        )
    if outlook.workspace_mm is not None:
        lines.append(f"expected uncertainty of a point anywhere in reach: {outlook.workspace_mm:.3f} mm rms")
    lines.append("least well determined: " + ", ".join(f"{n} (+-{s:.2g} {u})" for n, s, u in outlook.weakest))
    if outlook.correlated:
        lines.append("hard to tell apart: " + ", ".join(f"{a} / {b} ({c:+.2f})" for a, b, c in outlook.correlated[:6]))
    seen = sum(e.seen for e in sight.effects)
    lines.append(f"would show {seen} of {len(sight.effects)} catalogued effects at their usual size")
    if sight.alike:
        lines.append("effects that look alike here: " + ", ".join(f"{a} / {b} ({c:+.2f})" for a, b, c in sight.alike[:6]))
    return lines
