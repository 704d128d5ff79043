"""Recorded sweeps into observations: balls in profiles, and the pose of the arm at each profile by one clock for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbcacq.calibration.profile_clock import PART_S, ProfilesInMotion, SeenSections, SensorClock, adjust_in_motion, misfit_mm, passes_of
from mbcacq.devices import Cycles
from mbcacq.errors import RecordingError
from mbcacq.geometry import se3
from mbcacq.geometry.motion_in_time import FlangeMotion
from mbcacq.model.cell import Cell
from mbcacq.model.observations import Observations
from mbcacq.spheres.circles import Circle, circles_in

Row = dict[str, Any]
MARGIN_MM = 12.0  # around a ball, by which hand-eye transform and station may be off before they are calibrated
SAME_CLOCK_S = 0.5  # by which the start of the sensor may lag behind the order
# Starts of the delay, s beside what the orders say: of 25 ms the adjustment moves 2.5 mm at 100 mm/s, as much as the hand-eye transform.
LATE_S = np.linspace(-1.0, 1.0, 41)
LEAST = 5  # profiles of a sweep that show its ball


@dataclass(frozen=True)
class SweptBalls:
    """Circles of all sweeps; row, ball (P,): index of the sweep, and of the ball in the cell."""

    seen: SeenSections
    sweep: np.ndarray
    ball: np.ndarray


def sweep_observations(measured: Observations, sweeps: Sequence[Row], cycles: Sequence[Cycles], source: str) -> Observations:
    """The observations with a pose for each way over a ball, instead of the pose at which its sweep began.

    measured: poses as they were recorded, those of sweeps without centres. cycles: of each part of the recording. Raises RecordingError
    where no sweep shows its ball, no cycles were recorded with them, or a clock began anew between two parts.
    """
    cell = measured.cell
    pose = {int(number): i for i, number in enumerate(measured.pose_id)}
    sweeps = [row for row in sweeps if int(row["pose"][0]) in pose]
    swept = balls_of_sweeps(cell, sweeps, source)
    motion = _motion(cell, cycles, source)
    at = np.array([pose[int(row["pose"][0])] for row in sweeps])[swept.sweep]
    station = measured.station[at]
    _, sphere = np.unique(station * len(cell.ball_ids) + swept.ball, return_inverse=True)
    part = np.array([int(row["part"][0]) for row in sweeps])
    seen = replace(swept.seen, sphere=sphere, time_s=swept.seen.time_s + PART_S * part[swept.sweep])
    began = np.array([float(row["began_s"][0]) - float(row["time_s"][0]) for row in sweeps])
    apart = np.array([np.median(began[part == p]) for p in np.unique(part)])
    if np.ptp(apart) > SAME_CLOCK_S:
        raise RecordingError(
            f"{source}: the clock of the controller or of the scanner began anew between two parts of the run, by {np.ptp(apart):.1f} s; "
            "calibrate each part by its own recording (run.rrd, run.part2.rrd ..)"
        )
    epoch_s, near_s = float(swept.seen.time_s.mean()), float(np.median(began))
    starts = [_start(cell, motion, seen, SensorClock(epoch_s, near_s + late, 0.0, np.zeros((2, 2)))) for late in LATE_S]
    found = adjust_in_motion(motion, seen, min(starts, key=lambda start: misfit_mm(motion, seen, start)))
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


def _motion(cell: Cell, cycles: Sequence[Cycles], source: str) -> FlangeMotion:
    """The arm of all parts, which are set apart: their times may overlap."""
    parts = [np.unique(c.columns["time_s"], return_index=True) if len(c) else (np.zeros(0), np.zeros(0, int)) for c in cycles]
    if not any(len(time) for time, _ in parts):
        raise RecordingError(f"{source}: its sweeps have no cycles of the arm, so nobody can tell where it was; record them again")
    time = np.concatenate([PART_S * p + time for p, (time, _) in enumerate(parts)])
    q = np.concatenate([c.columns["q"][first] for c, (_, first) in zip(cycles, parts, strict=True) if len(c)])
    return FlangeMotion(cell.robot.chain, time, q)


def _start(cell: Cell, motion: FlangeMotion, seen: SeenSections, clock: SensorClock) -> ProfilesInMotion:
    """Start values: the given hand-eye transform, and each sphere where its largest circles are, which are near its middle."""
    X, count = cell.T_flange_scanner, int(seen.sphere.max()) + 1
    T = motion.at(clock.controller_time(seen.time_s))[0] @ X
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
        clock=clock,
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
    time_s, xyz, covariance, profile = passes_of(motion, seen, found, 2 * swept.sweep + (found.passing[:, 1] > 0))
    t, of = found.clock.controller_time(time_s), at_pose[profile]
    count, T, part = len(t), found.T_hand_eye, np.rint(time_s / PART_S)
    velocity = motion.at(t)[1]
    return Observations(
        cell=replace(measured.cell, T_flange_scanner=T),
        pose_id=np.arange(count),
        station=measured.station[of],
        phase=None if measured.phase is None else measured.phase[of],
        q=motion.coordinates(t),
        direction=np.sign(motion.coordinates(t + 0.01) - motion.coordinates(t - 0.01)).astype(int),
        pose=np.arange(count),
        ball=swept.ball[profile],
        xyz=xyz,
        time_s=t - part * PART_S,
        sensor_time_s=time_s - part * PART_S,
        flange_velocity=velocity,
        covariance=covariance,
        temperatures={name: values[of] for name, values in measured.temperatures.items()},
        cell_yaml=measured.cell_yaml,
    )
