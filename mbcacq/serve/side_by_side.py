"""Runs side by side: the figures of each, and what changed from the first to the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mbcacq.errors import MbcacqError
from mbcacq.serve.run_row import RunRow
from mbcacq.workflow.compare_runs import compare_results

MOST_RUNS = 4


def figures_of(rows: Sequence[RunRow]) -> list[tuple[str, list[tuple[str, str]]]]:
    """(label, (value, remark) of each run) of the figures that page one of the reports has; '–' where a report lacks one."""
    contents = [row.overview.content for row in rows]
    listed = [{label: (value, remark) for label, value, remark in (c.headlines if c is not None else ())} for c in contents]
    labels = dict.fromkeys(label for one in listed for label in one)
    return [(label, [one.get(label, ("–", "")) for one in listed]) for label in labels]


def changes(rows: Sequence[RunRow]) -> list[dict[str, Any]]:
    """What ``mbcacq compare`` says of the first run against each other one: 'names', and 'rows' with 'verdict', or 'why_not'."""
    out = []
    for other in rows[1:]:
        names = (rows[0].found.name, other.found.name)
        try:
            if not (rows[0].overview.best and other.overview.best):
                raise MbcacqError("one of them is a check, or has no result that can be read; choose two calibrations")
            found = compare_results(rows[0].overview.best, other.overview.best, names)
        except MbcacqError as error:
            out.append({"names": names, "why_not": str(error), "rows": [], "verdict": ""})
            continue
        shown = sorted(found.table, key=lambda row: not row[0])  # the significant ones first
        out.append({"names": names, "why_not": "", "rows": shown, "verdict": ". ".join([*found.sentences, found.how])})
    return out
