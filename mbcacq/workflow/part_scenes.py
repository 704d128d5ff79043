"""The scans of parts in a recording as observations of its cell."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.model.observations import Observations
from mbcacq.parts.observations import observations_of_parts
from mbcacq.parts.options import PartOptions
from mbcacq.parts.scans import PartScan, Scans, ScanSurface, spacing, surface_of, thinned
from mbcacq.parts.scene import register
from mbcacq.spheres.cloud_files import SUFFIXES, read_points


def scenes_as_observations(source: Path, obs: Observations) -> Observations:
    """The recording's scans of parts, brought together station by station, each from where the cell as described puts it.

    Raises ConfigError if no two scans of a station overlap, or it has none.
    """
    o, chain = PartOptions(), obs.cell.robot.chain
    pose_of = {int(number): k for k, number in enumerate(obs.pose_id)}
    scenes = {}
    for station in obs.cell.stations:
        there = obs.station == obs.cell.stations.index(station)
        if not (obs.cell.artefact(station.artefact).is_part and there.any()):
            continue
        try:
            most = min(o.points_per_scan, o.points_in_memory // int(there.sum()))
            scans, _ = thinned_scans(scans_at(source, obs, station.id), most)
            poses = np.array([pose_of[scan.number] for scan, _ in scans])
            scene = register([surface for _, surface in scans], chain.flange(obs.q[poses]) @ obs.cell.T_flange_scanner, o)
        except ConfigError as error:
            raise ConfigError(f"station '{station.id}': {error}") from None
        scenes[station.id] = scene, np.delete(poses, list(scene.left_out))
    if not scenes:
        raise ConfigError("the recording holds no scan of its parts; scan them, or give a recording of balls")
    return observations_of_parts(obs, scenes)


def thinned_scans(scans: Scans, most: int) -> tuple[list[tuple[PartScan, ScanSurface]], float]:
    """The first exposure of every pose with at most so many points; and the median spacing of the points in mm.

    Further exposures of a pose stand where the first one does: they tell nothing of the cell.
    """
    kept, apart = [], []
    for scan in scans():
        if kept and scan.number == kept[-1][0].number:
            continue
        surface = surface_of(scan)
        some = thinned(surface, most)
        kept.append((PartScan(scan.number, scan.q, some.points), some))
        apart.append(spacing(surface.points))
    if not kept:
        raise ConfigError("the recording holds no scan of the part; was it recorded with keep_clouds, or are its clouds in scans/POSE.ply?")
    return kept, float(np.median(apart))


def scans_at(source: Path, observations: Observations, station: str) -> Scans:
    index = [s.id for s in observations.cell.stations].index(station)
    of_pose = {int(n): q for n, q, s in zip(observations.pose_id, observations.q, observations.station, strict=True) if s == index}
    read = _of_folder if (source / "cell.yaml").is_file() else _of_run
    return lambda: read(source, of_pose)


def _of_run(source: Path, of_pose: dict[int, np.ndarray]) -> Iterator[PartScan]:
    """Scans of a recording; the exposures of a pose one after the other."""
    from mbcacq.recording.rrd.reader import open_recordings

    for recording in open_recordings(source):
        for taken in recording.scans():
            if taken.pose in of_pose and len(taken.scan.points):
                yield PartScan(taken.pose, of_pose[taken.pose], taken.scan.points)


def _of_folder(source: Path, of_pose: dict[int, np.ndarray]) -> Iterator[PartScan]:
    for number, q in of_pose.items():
        for path in (source / "scans" / f"{number}{suffix}" for suffix in SUFFIXES):
            if path.is_file():
                yield PartScan(number, q, read_points(path))
                break
