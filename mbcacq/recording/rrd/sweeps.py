"""Recorded sweeps into observations: balls in profiles, and the pose of the arm at each profile by one clock for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbcacq.calibration.profile_clock import ProfilesInMotion, SeenSections, SensorClock, adjust_in_motion, passes_of
from mbcacq.devices import Cycles
from mbcacq.errors import RecordingError
from mbcacq.geometry import se3
from mbcacq.geometry.motion_in_time import FlangeMotion
from mbcacq.model.cell import Cell
from mbcacq.model.observations import Observations
from mbcacq.spheres.circles import Circle, circles_in

Row = dict[str, Any]
MARGIN_MM = 12.0  # around a ball, by which hand-eye transform and station may be off before they are calibrated
LEAST = 5  # profiles of a sweep that show its ball


@dataclass(frozen=True)
class SweptBalls:
    """Circles of all sweeps; row, ball (P,): index of the sweep, and of the ball in the cell."""

    seen: SeenSections
    sweep: np.ndarray
    ball: np.ndarray


def sweep_observations(measured: Observations, sweeps: Sequence[Row], cycles: Cycles, source: str) -> Observations:
    """The observations with a pose for each profile that shows a ball, instead of the pose at which its sweep began.

    measured: poses as they were recorded, those of sweeps without centres. Raises RecordingError where no sweep shows its ball, or no
    cycles were recorded with them.
    """
    cell = measured.cell
    if not len(cycles):
        raise RecordingError(f"{source}: its sweeps have no cycles of the arm, so nobody can tell where it was; record them again")
    pose = {int(number): i for i, number in enumerate(measured.pose_id)}
    sweeps = [row for row in sweeps if int(row["pose"][0]) in pose]
    swept = balls_of_sweeps(cell, sweeps, source)
    time, first = np.unique(cycles.columns["time_s"], return_index=True)
    motion = FlangeMotion(cell.robot.chain, time, cycles.columns["q"][first])
    at = np.array([pose[int(row["pose"][0])] for row in sweeps])[swept.sweep]
    station = measured.station[at]
    _, sphere = np.unique(station * len(cell.ball_ids) + swept.ball, return_inverse=True)
    seen = replace(swept.seen, sphere=sphere)
    began = np.array([float(row["began_s"][0]) - float(row["time_s"][0]) for row in sweeps])
    found = adjust_in_motion(motion, seen, _start(cell, motion, seen, float(np.median(began))))
    return _assembled(measured, found, motion, seen, swept, at)


def balls_of_sweeps(cell: Cell, sweeps: Sequence[Row], source: str) -> SweptBalls:
    """The circles in the profiles of each sweep, near where its ball was expected; sweeps that hardly show it are left out."""
    time, radius, noise, of_sweep, of_ball = [], [], [], [], []
    circles: list[Circle] = []
    diameters = np.concatenate([a.diameters for a in cell.artefacts])
    for k, row in enumerate(sweeps):
        ball = cell.ball_ids.index(int(row["ball"][0]))
        R, middle = float(diameters[ball] / 2), row["expected"][[0, 2]]
        profiles = np.split(row["points"].reshape(-1, 2).astype(float), row["first"][1:])
        reach = np.array([2 * R + MARGIN_MM, R + MARGIN_MM])  # a ball moves along the laser line while a sweep crosses it aslant
        found, sigma = circles_in([p[(np.abs(p - middle) < reach).all(axis=1)] for p in profiles], R)
        shown = np.array([c is not None and c.radius < R + 10 * sigma * np.sqrt(c.cofactor[2, 2]) for c in found], dtype=bool)
        count = int(shown.sum())
        if count < LEAST:
            continue
        circles += [c for c, s in zip(found, shown, strict=True) if c is not None and s]
        noise.append(sigma)
        time.append(row["time_s"][shown])
        radius.append(np.full(count, R))
        of_sweep.append(np.full(count, k))
        of_ball.append(np.full(count, ball))
    if not circles:
        raise RecordingError(f"{source}: no sweep shows its ball; look at the scanner's exposure, its field of view and the artefact")
    times, sizes, which = np.concatenate(time), np.concatenate(radius), np.concatenate(of_sweep)
    seen = SeenSections(times, np.zeros(len(times), int), sizes, circles, float(np.median(noise)))
    return SweptBalls(seen, which, np.concatenate(of_ball))


def _start(cell: Cell, motion: FlangeMotion, seen: SeenSections, delay: float) -> ProfilesInMotion:
    """Start values: the given hand-eye transform, and each sphere where its largest circles are, which are near its middle."""
    X, count = cell.T_flange_scanner, int(seen.sphere.max()) + 1
    T = motion.at(seen.time_s + delay)[0] @ X
    size = np.array([c.radius for c in seen.circles])
    middle = np.array([[c.centre[0], 0.0, c.centre[1]] for c in seen.circles])
    place, spheres = se3.apply(T, middle), np.zeros((count, 3))
    for k in range(count):
        of = np.flatnonzero(seen.sphere == k)
        spheres[k] = np.median(place[of[size[of] >= np.quantile(size[of], 0.7)]], axis=0)
    nothing = np.zeros((len(size), 6))
    return ProfilesInMotion(
        T_hand_eye=X,
        spheres=spheres,
        clock=SensorClock(float(seen.time_s.mean()), delay, 0.0, np.zeros((2, 2))),
        covariance=np.eye(8 + 3 * count),
        pose_sigma_mm=0.0,
        used=np.ones(len(size), dtype=bool),
        sphere_in_scanner=nothing[:, :3],
        velocity=nothing,
        passing=nothing[:, :3],
    )


def _assembled(
    measured: Observations, found: ProfilesInMotion, motion: FlangeMotion, seen: SeenSections, swept: SweptBalls, at_pose: np.ndarray
) -> Observations:
    """A pose for each way of a sweep: what the arm is off by is the same all along it, and differs from the way back."""
    ways = passes_of(motion, seen, found, 2 * swept.sweep + (found.passing[:, 1] > 0))
    t, of = found.clock.controller_time(ways.time_s), at_pose[ways.profile]
    count, T = len(t), found.T_hand_eye
    velocity = motion.at(t)[1]
    return Observations(
        cell=replace(measured.cell, T_flange_scanner=T),
        pose_id=np.arange(count),
        station=measured.station[of],
        phase=None if measured.phase is None else measured.phase[of],
        q=motion.coordinates(t),
        direction=np.sign(motion.coordinates(t + 0.01) - motion.coordinates(t - 0.01)).astype(int),
        pose=np.arange(count),
        ball=swept.ball[ways.profile],
        xyz=ways.xyz,
        time_s=t,
        sensor_time_s=ways.time_s,
        flange_velocity=velocity,
        covariance=ways.covariance,
        temperatures={name: values[of] for name, values in measured.temperatures.items()},
        cell_yaml=measured.cell_yaml,
    )
