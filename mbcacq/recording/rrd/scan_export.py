"""The clouds of a run as ``scans/POSE.ply`` of an observation set."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from mbcacq.recording.datasets.scan_folder import ply_content
from mbcacq.recording.rrd.reader import RecordedScan, open_recordings


def scans_to_write(run: Path | str) -> dict[str, Callable[[Path], object]]:
    """``scans/POSE.ply`` of the first exposure of every pose of a run, for ``write_files``: each cloud is read when its turn comes."""
    last = {scan.pose: k for k, (scan, _) in enumerate(_first_exposures(run))}  # a pose may be scanned again in a later part
    chosen = set(last.values())
    scans = (found for k, found in enumerate(_first_exposures(run)) if k in chosen)

    def write_next(path: Path) -> None:
        taken, simulated = next(scans)
        path.write_bytes(ply_content(taken.scan.points, taken.scan.intensity, simulated))

    return {f"scans/{pose}.ply": write_next for pose in sorted(last, key=last.__getitem__)}


def _first_exposures(run: Path | str) -> Iterator[tuple[RecordedScan, bool]]:
    """Scans one at a time, and whether they are simulated."""
    for recording in open_recordings(run):
        simulated = bool(recording.about().get("simulated"))
        for taken in recording.scans():
            if taken.exposure == 0:
                yield taken, simulated
