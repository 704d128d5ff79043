"""The content of a fleet's page: from rows, charts and outliers to plain values in mm and °."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from mbcacq.fleet.control_chart import ArmType, Outlier
from mbcacq.fleet.row import EVALUATED, FleetRow
from mbcacq.model.cell import SIMULATED
from mbcacq.quantities import capitalised, fixed, micrometres, with_unit
from mbcacq.report.several import TITLES, ArmTypeContent, FleetContent, scale_and_unit

MOST_LISTED = 200  # outliers and broken recordings on the page; the table has all


def fleet_content(rows: Sequence[FleetRow], kinds: Sequence[ArmType], outside: Sequence[Outlier]) -> FleetContent:
    """What the page shows."""
    broken = [row for row in rows if row.status != EVALUATED]
    arms = {(row.robot, row.arm) for row in rows if row.status == EVALUATED}
    headlines = [
        ("recordings", str(len(rows)), f"{len(rows) - len(broken)} evaluated"),
        ("arms", str(len(arms)), f"of {len(kinds)} type{'s' * (len(kinds) != 1)}"),
        ("outside the control limits", str(len({o.recording for o in outside if o.recording})), "recordings"),
        ("unlike the others", str(len({o.arm for o in outside if o.recording is None and not o.drift})), "arms"),
        ("drifting", str(len({o.arm for o in outside if o.drift})), "arms"),
        ("without a result", str(len(broken)), "recordings"),
    ]
    verdicts = Counter(row.verdict for row in rows if row.verdict)
    effects = Counter(effect for row in rows for effect in row.effects or ())
    return FleetContent(
        headlines=headlines,
        outliers=[_listed(o) for o in outside[:MOST_LISTED]],
        broken=[(row.arm, Path(row.recording).name, row.status, row.reason or "") for row in broken[:MOST_LISTED]],
        verdicts=[(verdict, str(count)) for verdict, count in verdicts.most_common()],
        effects=[(effect, str(count)) for effect, count in effects.most_common(20)],
        types=[_type(kind) for kind in kinds],
        unlisted=max(len(outside) - MOST_LISTED, 0) + max(len(broken) - MOST_LISTED, 0),
        caveat=_caveat(rows),
        recordings=[_recording(row) for row in sorted(rows, key=lambda row: (row.arm, row.time or ""))[:MOST_LISTED]],
    )


def _caveat(rows: Sequence[FleetRow]) -> str:
    """How many of the recordings no real arm made; '' where none."""
    simulated = sum(bool(row.simulated) for row in rows)
    share = "every recording is" if simulated == len(rows) else f"{simulated} of {len(rows)} recordings are"
    return f"{capitalised(share)} {SIMULATED}." if simulated else ""


def _recording(row: FleetRow) -> tuple[str, ...]:
    """A row of the list of recordings, as text."""
    return (
        row.arm,
        Path(row.recording).name + (" (simulated)" if row.simulated else ""),
        (row.time or "")[:10],
        str(row.poses or ""),
        "" if row.rms_mm is None else micrometres(row.rms_mm),
        "" if row.spacing_max_mm is None else f"{fixed(row.spacing_max_mm)} mm",
        (row.verdict or row.status).replace("_", " "),
    )


def _listed(outlier: Outlier) -> tuple[str, str, str, str, str, str]:
    """Arm, recording, figure, its difference from the centre line, the limit, and the two over each other."""
    scale, unit = scale_and_unit(outlier.name)
    away = outlier.value - outlier.centre
    where = "all, against the other arms" if outlier.recording is None else Path(outlier.recording).name
    where = "all, from the first to the last" if outlier.drift else where
    difference, limit = with_unit(f"{scale * away:+.4f}", unit), with_unit(f"{scale * outlier.limit:.4f}", unit)
    figures = (difference, f"± {limit}", f"{abs(away) / outlier.limit:.1f}")
    return (outlier.arm, where, TITLES.get(outlier.name, outlier.name), *figures)


def _type(kind: ArmType) -> ArmTypeContent:
    """Charts of a type, the one with the farthest outlier first."""
    charts = sorted((chart.as_read() for chart in kind.charts), key=lambda chart: -chart.farthest)
    names, times = zip(*((Path(row.recording).name, row.time or "") for row in kind.rows), strict=True)
    return ArmTypeContent(kind.robot, list(charts[0].arms) if charts else [], list(names), list(times), charts)
