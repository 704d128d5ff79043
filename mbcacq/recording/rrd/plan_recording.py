"""A plan as a rerun recording to look at: the arm on its path through all poses, the stations and the obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mbcacq.files.atomic_write import replacing
from mbcacq.geometry import se3
from mbcacq.model.cell import Station
from mbcacq.plan import LoadedPlan, PlannedPose, Transit
from mbcacq.recording.rrd import layout, scene
from mbcacq.recording.rrd.blueprint import LOG_COLUMNS, collapsed, place_camera, space
from mbcacq.recording.rrd.drawable import drawable
from mbcacq.recording.rrd.new_stream import filed

FRAMES_A_MOTION = 16


def write_plan_recording(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit], starts: Sequence[float], file: Path
) -> None:
    """Write ``file`` (.rrd). starts: (P,) s, when each pose's first motion begins. Raises RecordingError where it cannot be written."""
    with replacing(file) as partial:
        _write(loaded, poses, transits, starts, partial)


def _write(loaded: LoadedPlan, poses: Sequence[PlannedPose], transits: Sequence[Transit], starts: Sequence[float], partial: Path) -> None:
    cell = loaded.cell
    viewpoint = place_camera(cell.robot.chain, np.array([_planned_pose(s)[:3, 3] for s in cell.stations]))
    view = space("Plan: the arm on its path, the artefacts at their stations, in mm", [f"+ /{layout.WORLD}/**"], viewpoint)
    log = rrb.TextLogView(name="Poses and when they begin", origin=layout.LOG, columns=LOG_COLUMNS)
    blueprint = rrb.Blueprint(rrb.Horizontal(view, log, column_shares=[3, 1]), *collapsed(layout.TIME))
    with filed(partial, blueprint, "mbcacq_plan") as rec:
        scene.log_static(rec, cell, loaded.text)
        rec.set_time(layout.TIME, duration=0.0)
        for station in cell.stations:
            artefact = cell.artefact(station.artefact)
            centres = se3.apply(_planned_pose(station), artefact.centres)
            scene.log_balls(rec, station.id, artefact, dict(zip(artefact.ball_ids, centres, strict=True)))
        scene.log_obstacles(rec, loaded.text)
        last = loaded.plan.robot.home
        for pose, transit, start, end in zip(poses, transits, starts, [*starts[1:], starts[-1] + 5.0], strict=True):
            stops = np.array([last, *transit, pose.q])
            # The arm moves in the first half of a pose's time, and stands in the second.
            share = np.linspace(0, len(stops) - 1, FRAMES_A_MOTION * (len(stops) - 1) + 1)
            path = np.stack([np.interp(share, np.arange(len(stops)), joint) for joint in stops.T], axis=1)
            for k, q in enumerate(path):
                rec.set_time(layout.TIME, duration=start + 0.5 * (end - start) * k / (len(path) - 1))
                scene.log_arm(rec, cell, q)
            seen = f"{len(pose.balls)} ball{'' if len(pose.balls) == 1 else 's'}"
            rec.log(
                layout.LOG, rr.TextLog(drawable(f"{start:.0f} s  pose {pose.number}: {pose.step_name}, station {pose.station}, {seen}"))
            )
            last = pose.q


def _planned_pose(station: Station) -> np.ndarray:
    assert station.T_base_station is not None, "the loader gives every station of a plan its planned pose"
    return station.T_base_station
