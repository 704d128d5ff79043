"""What is only drawn, written some poses together: each row that stands in a chunk of its own costs 2 kB, its values some bytes.

Measurements are written at once, and pass by this.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import rerun as rr

POSES = 12  # that are drawn together where nobody watches


class DrawnLater:
    """Takes the rows of a stream, with the times that they belong to, and writes them when it is asked to.

    stream: of the recording. at_once: somebody watches, so that every row is written as it comes.
    """

    def __init__(self, stream: rr.RecordingStream, *, at_once: bool) -> None:
        self._rec, self._at_once = stream, at_once
        self._times: dict[str, Mapping[str, Any]] = {}
        self._rows: list[tuple[dict[str, Mapping[str, Any]], str, tuple[Any, ...]]] = []

    def set_time(self, timeline: str, **value: Any) -> None:
        """Set the time of the stream, and of all that is drawn later."""
        self._rec.set_time(timeline, **value)
        self._times[timeline] = value

    def log(self, entity: str, *rows: Any, static: bool = False) -> None:
        """As of the stream; what is static is written at once."""
        if static or self._at_once:
            self._rec.log(entity, *rows, static=static)
        else:
            self._rows.append((dict(self._times), entity, rows))

    def send_columns(self, entity: str, indexes: Any, columns: Any) -> None:
        """As of the stream: columns are many rows already, with times of their own."""
        self._rec.send_columns(entity, indexes, columns)

    def write(self) -> None:
        """Everything taken since the last call, each row at its own times."""
        if not self._rows:
            return
        rows, self._rows = self._rows, []
        for times, entity, values in sorted(rows, key=lambda row: row[1]):  # stable: of an entity in their order
            for timeline, value in times.items():
                self._rec.set_time(timeline, **value)
            self._rec.log(entity, *values)
        for timeline, value in self._times.items():
            self._rec.set_time(timeline, **value)


Stream = rr.RecordingStream | DrawnLater
