"""Clock times and dates of logs as seconds."""

import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.files.table import Column, TableSchema, read_table

TIMES = TableSchema("a log", (Column("time", "s", assumed="s"),))


def times(tmp_path, *cells):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time", *cells]) + "\n")
    return read_table(path, TIMES).time("time")


@pytest.mark.parametrize(
    "cells",
    [
        ("0.5", "1.75"),
        ("500 ms", "1.75"),
        ("10:15:03.50", "10:15:04.75"),
        ("23:59:59", "00:00:00.25"),
        ("2026-11-25 10:15:03.5", "2026-11-25 10:15:04.75"),
        ("2026-12-31T23:59:59.50Z", "2027-01-01T01:00:00.750+01:00"),
        ("25.11.2026 10:15:03.5", "25.11.2026 10:15:04.75"),
    ],
)
def test_times_in_many_forms_are_as_far_apart(tmp_path, cells):
    assert np.diff(times(tmp_path, *cells)) == pytest.approx([1.25], abs=1e-6)


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        (("04/05/2026 10:00:00", "04/05/2026 10:00:01"), "log.csv:2: column time: .* may be day/month or month/day"),
        (("2026-02-30 10:00:00", "2026-03-01 10:00:00"), "is no day of the calendar"),
        (("10:00:00", "2026-03-01 10:00:00"), "log.csv:3: .* has a date where others have a time of day alone"),
        (("10:00:00", "5.5"), "log.csv:3: .* is no number, time of day or date"),
    ],
)
def test_times_of_two_meanings_are_refused(tmp_path, cells, words):
    with pytest.raises(ConfigError, match=words):
        times(tmp_path, *cells)
