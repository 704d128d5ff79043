"""The page "two recordings compared": what changed, with the report's own charts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbcacq.files.atomic_write import write_file
from mbcacq.quantities import capitalised, symbol
from mbcacq.report.content import Action
from mbcacq.report.several import ChangeRow, ChangesContent
from mbcacq.report.sources.from_result import spacing_of
from mbcacq.workflow.compare_runs import RunComparison, best_result

# A bracket that was mounted anew moves a thousand times as far as an arm drifts, and would hide it on one axis.
CHARTS = (
    ("Lengths of the arm", "lengths", "parameter", "mm"),
    ("Angles of the arm", "angles", "parameter", "deg"),
    ("Hand-eye transform, translation", "mount-lengths", "hand-eye", "mm"),
    ("Hand-eye transform, rotation", "mount-angles", "hand-eye", "deg"),
)


def write_page(found: RunComparison, path: Path | str, results: tuple[Mapping[str, Any], Mapping[str, Any]] | None = None) -> Path:
    """Write the page of a comparison. results: of the two recordings (default: read again by the names of the comparison).

    Raises RecordingError where it cannot be written.
    """
    from mbcacq.report.page import render_changes

    first, second = results or tuple(best_result(Path(name)) for name in found.names)
    return write_file(path, render_changes(_content(found, first, second)))


def _content(found: RunComparison, first: Mapping[str, Any], second: Mapping[str, Any]) -> ChangesContent:
    groups = [(title, name, [row for row in found.rows if row.what == what and row.unit == unit]) for title, name, what, unit in CHARTS]
    effects: dict[str, list] = {}
    for row in found.rows:
        if row.what == "effect":
            effects.setdefault(row.unit, []).append(row)
    groups += [(f"Effects, {symbol(unit)}", f"effects-{k}", rows) for k, (unit, rows) in enumerate(effects.items())]
    drawn = {
        name: [
            ChangeRow(name=row.title, unit=row.unit, change=row.change[0], expanded=row.change[1], marked=row.significant)
            for row in rows
            if row.change is not None and row.change[1] is not None
        ]
        for _, name, rows in groups
    }
    drawn = {name: rows for name, rows in drawn.items() if rows}
    spacings = [(name, spacing_of(result)) for name, result in zip(found.names, (first, second), strict=True)]
    headline, *reasons = found.sentences
    what, command = found.next_step
    return ChangesContent(
        title=f"{found.robot}: two recordings compared",
        names=found.names,
        headline=headline,
        reason=" ".join(f"{reason}." for reason in reasons),
        changed=bool(found.changed),
        next=Action(capitalised(what), "", command),
        charts=[(title, name) for title, name, _ in groups if name in drawn],
        rows=drawn,
        spacings=[(name, spacing) for name, spacing in spacings if spacing is not None],
        table=found.table,
        caveats=["Simulated: the fake cell or a model made these data."] if first.get("simulated") or second.get("simulated") else [],
        footer=found.how,
    )
