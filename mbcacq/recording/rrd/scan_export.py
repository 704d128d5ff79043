"""The clouds of a run as ``scans/POSE.ply`` of an observation set."""

from __future__ import annotations

from pathlib import Path

from mbcacq.errors import RecordingError
from mbcacq.recording.datasets.scan_folder import write_ply
from mbcacq.recording.rrd.reader import open_recordings


def write_scans(run: Path | str, folder: Path | str) -> int:
    """Write the first exposure of every pose of a run as ``scans/POSE.ply``. Returns the number of clouds."""
    target = Path(folder) / "scans"
    written: set[int] = set()
    try:
        target.mkdir(parents=True, exist_ok=True)
        for recording in open_recordings(run):
            simulated = bool(recording.about().get("simulated"))
            for taken in recording.scans():
                if taken.exposure == 0:
                    write_ply(target / f"{taken.pose}.ply", taken.scan.points, taken.scan.intensity, simulated)
                    written.add(taken.pose)
    except OSError as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(f"{target} cannot be written: {error.strerror}; choose another folder or free the disk") from error
    return len(written)
