"""Whole dry runs in which one exposure is wrong: nothing is averaged over it, and the run folder names it."""

import numpy as np
from short_run import readable, run_with

from mbcacq.acquisition import events
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.run_folder.gaps import find_gaps


def twice(plan):
    plan["exposures"] = 2


def largest_scatter_mm(folder):
    return max(float(np.max(row["scatter_mm"])) for row in Recording(folder / "run.rrd").observed())


def test_after_a_flipped_bit_in_a_scan_header_it_is_exposed_again(tmp_path):
    error, folder = run_with(tmp_path, lambda cell: cell.faults.scanner("shifted_surface", times=1), twice)
    assert error is None
    readable(folder, [0, 1, 2, 3], "success")
    assert find_gaps(folder) == []
    assert largest_scatter_mm(folder) < 0.05


def test_an_artefact_bumped_between_two_exposures_is_named(tmp_path):
    def bump(cell):
        cell.faults.mishap("bumped_tripod", station="p1", shift_mm=(0.5, 0, 0), rotation_deg=(0, 0, 0))

    error, folder = run_with(tmp_path, bump, twice, at=(events.ScanTaken, 2))
    assert error is None
    gaps = "; ".join(find_gaps(folder))
    assert "pose 2: its exposures differ by 0.5" in gaps
    assert "if the artefact was touched then" in gaps
    assert largest_scatter_mm(folder) < 0.05
