"""The scans of parts in a recording as observations of its cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.parts_left_out import TransferFigures
from mbcacq.calibration.transfer import OVERLAPS, Transfer
from mbcacq.errors import ConfigError
from mbcacq.model.observations import Observations
from mbcacq.parts.agreement import CLEAR, agreement
from mbcacq.parts.observations import observations_of_parts
from mbcacq.parts.options import PartOptions
from mbcacq.parts.placement import CellPlacement
from mbcacq.parts.scans import PartScan, Scans, ScanSurface, spacing, surface_of, thinned
from mbcacq.parts.scene import register
from mbcacq.quantities import micrometres
from mbcacq.recording.rrd.reader import open_recordings
from mbcacq.spheres.cloud_file import SMALL, SMALLEST_MM
from mbcacq.spheres.cloud_files import SUFFIXES, read_points

LARGEST_INCHES = 12.0  # of what a scanner sees at once


def scenes_as_observations(source: Path, obs: Observations) -> Observations:
    """The recording's scans of parts, brought together station by station, each from where the cell as described puts it.

    Raises ConfigError if no two scans of a station overlap, or it has none.
    """
    chain = obs.cell.robot.chain
    pose_of = {int(number): k for k, number in enumerate(obs.pose_id)}
    scenes = {}
    for station in stations_of_parts(obs):
        try:
            scans, _ = thinned_scans(source, obs, station)
            poses = np.array([pose_of[scan.number] for scan in scans])
            placed = chain.flange(obs.q[poses]) @ obs.cell.T_flange_scanner
            scene = register(scans, placed, PartOptions())
        except ConfigError as error:
            raise ConfigError(f"station '{station}': {error}") from None
        scenes[station] = scene, np.delete(poses, list(scene.left_out))
    if not scenes:
        raise ConfigError("the recording holds no scan of its parts; scan them, or give a recording of balls")
    return observations_of_parts(obs, scenes)


def stations_of_parts(obs: Observations) -> list[str]:
    """Ids of the stations at which parts were scanned."""
    there = np.unique(obs.station)
    return [s.id for k, s in enumerate(obs.cell.stations) if k in there and obs.cell.artefact(s.artefact).is_part]


def trials_on_parts(source: Path, obs: Observations) -> list[tuple[str, Callable[[CalibratedCell, CalibratedCell], Transfer]]]:
    """Trials of a cell, and of geometry alone, on the scans of parts beside the balls that they were learnt from; with their names."""
    names = {station: f"the scans of the part at station '{station}'" for station in stations_of_parts(obs)} if obs.n_centres else {}
    return [(name, partial(_trial_on_part, source, obs, station, name)) for station, name in names.items()]


def _trial_on_part(source: Path, obs: Observations, station: str, name: str, cell: CalibratedCell, alone: CalibratedCell) -> Transfer:
    """How well scans agree by geometry alone and with effects, and whether they show these: by the difference of the mean squares of all
    overlaps, with its uncertainty by leaving out each scan (Arvesen 1969)."""
    scans, _ = thinned_scans(source, obs, station)
    ways = [CellPlacement("alone", alone), *([CellPlacement("effects", cell)] if cell.effects else ())]
    found = agreement(scans, ways, PartOptions())
    by_name = {way.name: np.array([pair.by_placement[way.name] for pair in found.pairs]) for way in ways}
    before, after = by_name["alone"], by_name[ways[-1].name]
    gain, of = before**2 - after**2, np.array([pair.poses for pair in found.pairs])
    without = np.array([gain[(of != number).all(axis=1)].mean() for number in np.unique(of)])
    sigma = float(np.sqrt((len(without) - 1) * np.var(without)))
    if not cell.effects:
        verdict = "they agree as well as expected" if found.ratio < CLEAR else "they show that an effect is missing"
    elif gain.mean() > 2 * sigma:
        verdict = "they confirm what was found" + ("" if found.ratio < CLEAR else ", and show that something is missing")
    else:
        verdict = "they contradict what was found" if gain.mean() < -2 * sigma else "they cannot tell whether what was found is right"
    figures = [
        TransferFigures(found.rms_mm(way.name), float(np.median(mm)), float(np.mean([pair.normalised[way.name] for pair in found.pairs])))
        for way, mm in zip(ways, by_name.values(), strict=True)
    ]
    return Transfer(
        place=OVERLAPS,
        poses=len(scans),
        centres=len(found.pairs),
        geometry_alone=figures[0],
        with_effects=figures[-1],
        own_geometry=None,
        effects=(),
        normalised_error=None,
        warnings=(f"{verdict}; {micrometres(found.expected_mm)} are expected of the calibration and the scanner",),
        recording=name,
    )


def thinned_scans(source: Path, obs: Observations, station: str) -> tuple[list[ScanSurface], float]:
    """The first exposure of every pose at a station, thinned; and the median spacing of the points in mm.

    Further exposures of a pose stand where the first one does: they tell nothing of the cell.
    """
    kept, apart, o = [], [], PartOptions()
    box = obs.cell.artefact(obs.cell.station(station).artefact).box
    in_inches = 0.0 if box is None else min(LARGEST_INCHES, float(np.ptp(box, axis=0).max()) / SMALL)
    count = int((obs.station == [s.id for s in obs.cell.stations].index(station)).sum())
    most = min(o.points_per_scan, o.points_in_memory // max(count, 1))
    for scan in scans_at(source, obs, station)():
        if kept and scan.number == kept[-1].number:
            continue
        span = float(np.ptp(scan.points, axis=0).max(initial=0.0))
        if 0 < span < in_inches or 0 < np.abs(scan.points).max(initial=0.0) < SMALLEST_MM:
            unit = "metres" if span < SMALLEST_MM / SMALL else "inches"
            raise ConfigError(f"the scan of pose {scan.number} spans {span:.3g} mm, which looks like {unit}; convert the clouds to mm")
        surface = surface_of(scan)
        kept.append(thinned(surface, most))
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
