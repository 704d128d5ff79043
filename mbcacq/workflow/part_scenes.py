"""The scans of parts in a recording as observations of its cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.model.observations import Observations
from mbcacq.parts.observations import observations_of_parts
from mbcacq.parts.options import PartOptions
from mbcacq.parts.scene import register
from mbcacq.workflow.merge_scans import scans_at, thinned_scans


def scenes_as_observations(source: Path, obs: Observations) -> Observations:
    """The recording's scans of parts, brought together station by station, each from where the cell as described puts it.

    Raises ConfigError where no two scans of any station overlap.
    """
    o, chain = PartOptions(), obs.cell.robot.chain
    pose_of = {int(number): k for k, number in enumerate(obs.pose_id)}
    scenes, faults = {}, []
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
            faults.append(error)
            continue
        scenes[station.id] = scene, np.delete(poses, list(scene.left_out))
    if not scenes:
        raise faults[0] if faults else ConfigError("the recording holds no scan of its parts; scan them, or give a recording of balls")
    return observations_of_parts(obs, scenes)
