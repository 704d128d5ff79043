"""The scans of a part in a recording, merged by the calibrated cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.errors import ConfigError
from mbcacq.geometry.flange_poses import FlangePoses
from mbcacq.model.observations import Observations
from mbcacq.parts.agreement import Agreement, agreement
from mbcacq.parts.merge import Merged, merge
from mbcacq.parts.options import PartOptions
from mbcacq.parts.placement import placements
from mbcacq.parts.scans import PartScan, Scans, Surface, surface_of, thinned
from mbcacq.workflow.load import as_cell, is_run_folder

VOXELS_PER_SPACING = 1.0


@dataclass(frozen=True)
class MergedPart:
    """What was made of the scans of a part: where it stood, its cloud, and how well its scans agree."""

    station: str
    cloud: Path
    merged: Merged
    agreement: Agreement
    voxel_mm: float
    simulated: bool

    def to_dict(self) -> dict[str, Any]:
        return {
            "format": "mbcacq-merge/1",
            **({"simulated": True} if self.simulated else {}),
            "station": self.station,
            "cloud": str(self.cloud),
            "voxel_mm": self.voxel_mm,
            "scans": self.merged.scans,
            "points": {"read": self.merged.read, "kept": self.merged.kept},
            "sigma_mm": {"median": self.merged.sigma_mm, "largest": self.merged.worst_mm},
            "agreement": self.agreement.to_dict(),
        }


def merge_scans(
    source: Path | str,
    out: Path | str,
    *,
    result: CalibratedCell | dict[str, Any] | Path | str | None = None,
    station: str | None = None,
    voxel_mm: float | None = None,
    options: PartOptions | None = None,
    progress: Callable[[str], None] = lambda sentence: None,
) -> MergedPart:
    """Place all scans of a part by a calibrated cell, compare them where they overlap, and write them as one cloud.

    Parameters
    ----------
    source
        Run folder, or observation set with ``scans/POSE.ply``.
    out
        The PLY to write: base frame, mm; with normals, ``sigma_mm`` (standard uncertainty along the normal) and ``scan`` (number of the
        pose).
    result
        The calibrated cell; default: that of the run.
    station
        Where the part stood; needed where parts stood at several.
    voxel_mm
        In each voxel of this edge the best known point stays; default: the spacing of a scan's points.

    Raises
    ------
    ConfigError
        The recording holds no part, its scans do not overlap, or the result is of another arm.
    """
    from mbcacq.recording import load_observations

    o = options or PartOptions()
    source, out = Path(source), Path(out)
    cell = as_cell(source if result is None else result)
    observations = load_observations(source)
    if isinstance(cell.nominal, FlangePoses) or observations.q.shape[1] != cell.nominal.n:
        raise ConfigError("the result and the recording are of different arms; give the result of this cell")
    station = _station(observations, station)
    scans = _scans(source, observations, station)
    progress("comparing the scans where they overlap")
    count = int((observations.station == [s.id for s in observations.cell.stations].index(station)).sum())
    seen = _thinned(scans, min(o.points_per_scan, o.points_in_memory // max(count, 1)), o)
    ways = placements(cell)
    compared = agreement(seen[0], ways, o)
    voxel = voxel_mm or VOXELS_PER_SPACING * seen[1]
    progress("merging them")
    noise = compared.scatter_mm, compared.noise.sigma_mm / np.sqrt(2)  # the distance of two scans has the noise of both
    merged = merge(scans, ways[-1], noise, voxel, out, o, observations.cell.simulated)
    return MergedPart(station, out, merged, compared, voxel, observations.cell.simulated)


def _station(observations: Observations, wanted: str | None) -> str:
    """Where the part stood. Raises ConfigError where that is not one station."""
    cell = observations.cell
    known = [s.id for s in cell.stations]
    if wanted is not None:
        if wanted not in known:
            raise ConfigError(f"there is no station '{wanted}' (there: {', '.join(known)}); name one of these")
        return wanted
    parts = [s.id for k, s in enumerate(cell.stations) if cell.artefact(s.artefact).is_part and (observations.station == k).any()]
    if len(parts) != 1:
        what = f"parts were scanned at {', '.join(parts)}" if parts else "no part was scanned, only artefacts"
        raise ConfigError(f"{what}; say whose scans are meant by --station (there: {', '.join(known)})")
    return parts[0]


def _thinned(scans: Scans, most: int, options: PartOptions) -> tuple[list[tuple[PartScan, Surface]], float]:
    """All scans with at most so many points each; and the median spacing of their points in mm."""
    kept, spacing = [], []
    for scan in scans():
        surface = surface_of(scan)
        some = thinned(surface, most)
        kept.append((PartScan(scan.number, scan.q, some.points), some))
        spacing.append(_spacing(surface.points))
    if not kept:
        raise ConfigError("the recording holds no scan of the part; was it recorded with keep_clouds, or are its clouds in scans/POSE.ply?")
    return kept, float(np.median(spacing))


def _spacing(points: np.ndarray) -> float:
    from scipy.spatial import KDTree

    return float(np.median(KDTree(points).query(points[:: max(1, len(points) // 300)], k=2)[0][:, 1]))


def _scans(source: Path, observations: Observations, station: str) -> Scans:
    index = [s.id for s in observations.cell.stations].index(station)
    of_pose = {int(n): q for n, q, s in zip(observations.pose_id, observations.q, observations.station, strict=True) if s == index}
    read = _of_run if is_run_folder(source) or source.is_file() else _of_folder
    return lambda: read(source, of_pose)


def _of_run(source: Path, of_pose: dict[int, np.ndarray]) -> Iterator[PartScan]:
    """Scans of a recording; the exposures of a pose one after the other."""
    from mbcacq.recording.rrd.reader import open_recordings

    for recording in open_recordings(source):
        for taken in recording.scans():
            if taken.pose in of_pose and len(taken.scan.points):
                yield PartScan(taken.pose, of_pose[taken.pose], taken.scan.points)


def _of_folder(source: Path, of_pose: dict[int, np.ndarray]) -> Iterator[PartScan]:
    from mbcacq.spheres.cloud_files import SUFFIXES, read_points

    for number, q in of_pose.items():
        for path in (source / "scans" / f"{number}{suffix}" for suffix in SUFFIXES):
            if path.is_file():
                yield PartScan(number, q, read_points(path))
                break
