"""Line profiles of one sphere that were taken while the arm moved: a table of the controller's cycles, and one of points with times.

Each table has the time of a clock of its own. The delay between both is estimated with the hand-eye transform.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.clock_term import clock_sentence
from mbcacq.calibration.profile_clock import ProfilesInMotion, SeenSections, adjust_in_motion, start_in_motion
from mbcacq.calibration.profile_start import CLEARLY, NEVER_MM, ProfileStart, find_start
from mbcacq.errors import ConfigError
from mbcacq.files.clock import in_seconds
from mbcacq.files.table import Table
from mbcacq.geometry.motion_in_time import FlangeMotion
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, TARGET_IN_BASE, Measurement
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets.columns import flange_group, joint_angles, joint_columns
from mbcacq.recording.datasets.line_profiles import (
    ProfileTable,
    Sections,
    check_diameter,
    circles_of_profiles,
    number_column,
    profile_columns,
    sphere_observations,
)
from mbcacq.recording.datasets.loose_table import MEASUREMENTS, TableOptions, UnderstoodTable, conventions_of, directed, in_units
from mbcacq.recording.datasets.pose_columns import LENGTHS

TIME_WORDS = ("t", "time", "timestamp", "time_stamp", "stamp", "clock")
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True)
class _ReadingInMotion:
    """What fits one reading of the cycles' columns."""

    words: str
    measurement: Measurement
    motion: FlangeMotion
    found: ProfilesInMotion
    start: ProfileStart


def read_profiles_in_motion(cycles: Table, points: Table, options: TableOptions) -> UnderstoodTable | None:
    """What tables of cycles and of points say together; None if these are not such tables.

    Raises ConfigError if times go back, nothing decides between readings, or the sweeps leave the hand-eye transform open.
    """
    columns = profile_columns(list(points.columns), None)
    times = [next((name for name in table.columns if _words(name)[0] in TIME_WORDS), None) for table in (cycles, points)]
    if columns is None or None in times or number_column(list(cycles.columns)) is not None or options.diameter_mm is None:
        return None
    cycle_s, point_s = (_seconds(table, str(name)) for table, name in zip((cycles, points), times, strict=True))
    rising = np.r_[True, np.diff(cycle_s) > 0]
    if (np.diff(cycle_s) < 0).any():
        raise ConfigError(f"{cycles.where(int(np.argmin(np.diff(cycle_s))) + 1, str(times[0]))}: the time goes back; give one recording")
    radius = options.diameter_mm / 2
    seen, sections, lost = _seen(points, columns, point_s, str(times[1]), radius, LENGTHS.get(options.length or ""))
    readings = sorted(_tried(cycles.rows(rising), cycle_s[rising], seen, radius, options), key=lambda r: r.start.misfit_mm)
    if not readings:
        raise ConfigError(f"{cycles.path}: no reading of its columns lets the profiles show one sphere; give tables of one recording")
    best, *others = readings
    if close := [o.words for o in others if o.start.misfit_mm < CLEARLY * max(best.start.misfit_mm, NEVER_MM)]:
        raise ConfigError(
            f"{points.path}: the profiles fit {best.words} no better than {'; or '.join(close)}; say which it is: --flange, --eye-in-hand "
            "or --eye-to-hand"
        )
    at, used = best.found, best.found.used
    t = at.clock.controller_time(seen.time_s)
    said = check_diameter(best.motion.at(t[used])[0], [c for c, u in zip(seen.circles, used, strict=True) if u], radius, best.start, points)
    obs = _observations(best, seen, sections, radius, options, str(points.path))
    return UnderstoodTable(obs, (*_sentences(best, seen, lost, radius), said))


def _words(name: str) -> tuple[str, str]:
    """A heading's word and its unit of time, which is s where it says none."""
    text = name.strip().lower().rstrip("])").replace("[", "_").replace("(", "_").replace(" ", "_")
    word, _, unit = text.rpartition("_")
    return (word.rstrip("_"), unit) if unit in TIME_UNITS and word else (text, "s")


def _seconds(table: Table, name: str) -> np.ndarray:
    """(rows,) s."""
    return in_seconds(table.time(name)) * TIME_UNITS[_words(name)[1]]


def _seen(
    points: Table, columns: ProfileTable, point_s: np.ndarray, time_name: str, radius: float, length: float | None
) -> tuple[SeenSections, Sections, int]:
    """Circles of the profiles, and how many profiles are missing by their numbers. A number that begins again is no gap; rows belong
    together while it stays the same."""
    numbers = points.integer(columns.number)
    first = np.flatnonzero(np.r_[True, (np.diff(numbers) != 0) | (np.diff(point_s) != 0)])
    time_s = point_s[first]
    if (np.diff(time_s) <= 0).any():
        row = int(first[int(np.argmax(np.diff(time_s) <= 0)) + 1])
        raise ConfigError(
            f"{points.where(row, time_name)}: the sensor's time goes back, or two profiles have one; its clock began anew, so give what "
            "came before and what came after as recordings of their own"
        )
    values = points.numbers(columns.points, empty=np.nan) * (columns.length or length or 1.0)
    sections = circles_of_profiles(np.split(values, first[1:]), np.arange(len(first)), first, radius, str(points.path))
    shown = sections.numbers
    gaps = np.diff(numbers[first])
    lost = int((gaps[gaps > 0] - 1).sum())
    count = len(shown)
    seen = SeenSections(time_s[shown], np.zeros(count, int), np.full(count, radius), sections.circles, sections.noise_mm)
    return seen, sections, lost


def _tried(cycles: Table, cycle_s: np.ndarray, seen: SeenSections, radius: float, options: TableOptions) -> Iterator[_ReadingInMotion]:
    """Every reading of the arm that headings and options allow."""
    measurements: list[Measurement] = [options.measurement] if options.measurement else [ARTEFACT_IN_SCANNER, TARGET_IN_BASE]
    motions: list[tuple[str, FlangeMotion]] = []
    if joints := joint_columns(cycles):
        if options.robot is None:
            raise ConfigError(f"{cycles.at_headings}: joint angles need the arm they are of: --robot NAME, or a robot file")
        q = joint_angles(cycles, joints, options.angle)
        motions.append((f"joint angles of {options.robot.name}", FlangeMotion(options.robot.chain, cycle_s, q)))
    elif (flange := flange_group(cycles)) is not None:
        flange = directed(flange, options.flange_inverted, cycles, "flange")
        for convention in conventions_of(flange, options.flange, "--flange"):
            group = in_units(replace(flange, convention=convention, alternatives=()), cycles, options)
            motions.append((f"flange: {group.described()}", FlangeMotion.of_poses(cycle_s, group.coordinates(cycles))))
    else:
        raise ConfigError(f"{cycles.at_headings}: no columns give joint angles or the pose of the flange; name them flange_x_mm ..")
    for words, motion in motions:
        for measurement in measurements:
            moving = replace(motion, inverted=measurement == TARGET_IN_BASE)
            try:
                found = adjust_in_motion(moving, seen, start_in_motion(moving, seen))
            except ConfigError:
                if len(motions) * len(measurements) == 1:
                    raise
                continue
            t = found.clock.controller_time(seen.time_s[found.used])
            circles = [c for c, u in zip(seen.circles, found.used, strict=True) if u]
            yield _ReadingInMotion(words, measurement, motion, found, find_start(moving.at(t)[0], circles, radius))


def _observations(
    best: _ReadingInMotion, seen: SeenSections, sections: Sections, radius: float, options: TableOptions, source: str
) -> Observations:
    """A pose for each profile that is used, at its time, with its velocity; jitter of the stamps is in each covariance."""
    found, used = best.found, best.found.used
    t = found.clock.controller_time(seen.time_s[used])
    T, velocity = best.motion.at(t)
    circles = [c for c, u in zip(seen.circles, used, strict=True) if u]
    at = replace(best.start, T_hand_eye=found.T_hand_eye, sphere=found.spheres[0], sphere_in_scanner=found.sphere_in_scanner[used])
    of_used = Sections(sections.rows[used], np.arange(1, len(circles) + 1), circles, sections.noise_mm, sections.others)
    obs = sphere_observations(T, best.measurement, at, of_used, radius, source)
    assert obs.covariance is not None, "profiles state it"
    passing = found.passing[used]
    covariance = obs.covariance + found.clock.jitter_s**2 * passing[:, :, None] * passing[:, None, :]
    obs = replace(obs, covariance=covariance, time_s=t, sensor_time_s=seen.time_s[used], flange_velocity=velocity)
    if options.robot is None or best.motion.chain is not options.robot.chain:
        return obs
    return replace(obs, q=best.motion.coordinates(t), cell=replace(obs.cell, robot=options.robot))


def _sentences(best: _ReadingInMotion, seen: SeenSections, lost: int, radius: float) -> Iterator[str]:
    found, clock = best.found, best.found.clock
    yield best.words
    yield f"line profiles in motion: {len(seen.circles)} show the sphere of {2 * radius:g} mm, a point within {1e3 * seen.noise_mm:.3g} um"
    yield f"{MEASUREMENTS[best.measurement]}; the profiles fit within {best.start.misfit_mm:.3g} mm (median)"
    yield clock_sentence(clock.delay_s, float(np.sqrt(clock.covariance[0, 0])), clock.drift, clock.jitter_s)
    missing = int((~found.used).sum())
    if missing or lost:
        yield f"{lost} profiles are missing by their numbers; {missing} are left out: gross errors, or no cycles around them"
