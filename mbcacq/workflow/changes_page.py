"""The page "two recordings compared": what changed, with the report's own charts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mbcacq.files.atomic_write import write_file
from mbcacq.report.page import render_changes
from mbcacq.report.several import RunComparison
from mbcacq.report.sources.from_result import spacing_of
from mbcacq.workflow.compare_runs import best_result


def write_page(found: RunComparison, path: Path | str, results: tuple[Mapping[str, Any], Mapping[str, Any]] | None = None) -> Path:
    """Write the page of a comparison. results: of the two recordings (default: read again by the names of the comparison).

    Raises RecordingError where it cannot be written.
    """
    both = results or tuple(best_result(Path(name)) for name in found.names)
    spacings = [(name, spacing) for name, result in zip(found.names, both, strict=True) if (spacing := spacing_of(result)) is not None]
    return write_file(path, render_changes(found, spacings, simulated=any(result.get("simulated") for result in both)))
