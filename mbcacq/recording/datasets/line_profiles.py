"""Line profiles of one sphere with the flange's pose of each: as one table, or as poses and points in two.

A row of points has x and z of the laser plane (``profile_x_mm``, ``profile_z_mm``; no y, or zeros) and the number of its profile. In one
table it repeats the pose of the flange; in two, the first has a pose for each profile, the second the points.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.profile_start import CLEARLY, NEVER_MM, ProfileStart, find_start, measured_centres, radius_by_profiles
from mbcacq.errors import ConfigError
from mbcacq.files.table import Table
from mbcacq.geometry import se3
from mbcacq.geometry.flange_poses import flange_coordinates
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, TARGET_IN_BASE, Artefact, Cell, Measurement, Station, arm_of_flange_poses
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets.columns import flange_group
from mbcacq.recording.datasets.loose_table import MEASUREMENTS, TableOptions, UnderstoodTable, conventions_of, directed, in_units
from mbcacq.recording.datasets.pose_columns import LENGTHS, PoseHeadings, heading
from mbcacq.spheres.circles import Circle, circles_in

NUMBER_WORDS = ("profile", "profile_no", "profile_id", "profile_number", "frame", "frame_index", "scan", "pose", "trigger")
LEAST_PROFILES = 12
SURE = 5.0  # standard uncertainties by which profiles contradict the stated radius
TRIED = 30  # profiles that readings of the columns are compared with


@dataclass(frozen=True)
class ProfileTable:
    """points: names of the columns x and z; length: mm of a unit. number: name of the column with the profile's number."""

    points: tuple[str, str]
    length: float | None
    number: str


def profile_columns(names: Sequence[str], flange: PoseHeadings | None) -> ProfileTable | None:
    """The columns of profiles among ``names``; None if no thing has x and z and no y, or nothing numbers them."""
    number = number_column(names)
    if number is None:
        return None
    taken = set(flange.names) if flange else set()
    parts: dict[str, dict[str, str]] = {}
    for name in names:
        part = heading(name)
        if name not in taken and part.component in ("x", "y", "z"):
            parts.setdefault(part.thing, {})[part.component] = name
    for of in parts.values():
        if set(of) == {"x", "z"}:
            return ProfileTable((of["x"], of["z"]), LENGTHS.get(heading(of["x"]).unit), number)
    return None


@dataclass(frozen=True)
class Sections:
    """The profiles of a table that show the sphere: the first row of each, its number, and its circle. noise_mm: of one point; others:
    how many profiles show none."""

    rows: np.ndarray
    numbers: np.ndarray
    circles: list[Circle]
    noise_mm: float
    others: int


def _sections(table: Table, columns: ProfileTable, radius: float, default_length: float | None) -> Sections:
    """The circle of each profile. Raises ConfigError if fewer than ``LEAST_PROFILES`` show the sphere."""
    numbers = table.integer(columns.number)
    values = table.numbers(columns.points, empty=np.nan) * (columns.length or default_length or 1.0)
    ids, first, which = np.unique(numbers, return_index=True, return_inverse=True)
    order = np.argsort(which, kind="stable")
    return circles_of_profiles(np.split(values[order], np.cumsum(np.bincount(which))[:-1]), ids, first, radius, str(table.path))


def circles_of_profiles(profiles: Sequence[np.ndarray], ids: np.ndarray, first: np.ndarray, radius: float, source: str) -> Sections:
    """The circles in profiles (n, 2) mm. ids: number of each profile; first: its first row. Raises ConfigError as ``_sections``."""
    circles, noise = circles_in(profiles, radius)
    shown = np.array([c is not None and c.radius < radius + 10 * noise * np.sqrt(c.cofactor[2, 2]) for c in circles], dtype=bool)
    if shown.sum() < LEAST_PROFILES:
        raise ConfigError(
            f"{source}: {int(shown.sum())} of {len(ids)} profiles show a circle of a sphere of {2 * radius:g} mm; at least "
            f"{LEAST_PROFILES} are needed, better 100: check the diameter (--diameter), the unit, and that the sphere is in view"
        )
    return Sections(first[shown], ids[shown], [c for c, s in zip(circles, shown, strict=True) if c and s], noise, int((~shown).sum()))


@dataclass(frozen=True)
class _Reading:
    """The hand-eye transform that fits one reading of the flange's columns."""

    flange: PoseHeadings
    hand: np.ndarray
    measurement: Measurement
    start: ProfileStart

    @property
    def words(self) -> str:
        return f"the flange's {self.flange.described()}, {MEASUREMENTS[self.measurement]}"


def read_profiles(table: Table, options: TableOptions, poses: Table | None = None) -> UnderstoodTable | None:
    """What a table of profiles says, or None if it is none. poses: the flange's pose of each profile, where it stands in a table of its
    own. Raises ConfigError if the diameter is not said, or nothing decides between readings."""
    flange = flange_group(table if poses is None else poses)
    columns = profile_columns(list(table.columns), flange if poses is None else None)
    if columns is None or (poses is None and len(set(table.text(columns.number))) == len(table)):
        return None
    if options.diameter_mm is None:
        raise ConfigError(
            f"{table.path}: these are line profiles; say the diameter of the sphere: mbcacq data new {table.path.name} --diameter 30 "
            "(mm), then calibrate the set"
        )
    radius = options.diameter_mm / 2
    sections = _sections(table, columns, radius, LENGTHS.get(options.length or ""))
    of_pose, rows = (table, sections.rows) if poses is None else (poses, _rows_of(poses, table, columns)[sections.rows])
    if flange is None:
        raise ConfigError(f"{of_pose.path}:1: no columns give the pose of the flange at each profile; name them flange_x_mm, .., flange_qw")
    flange = directed(flange, options.flange_inverted, of_pose, "flange")
    readings = _tried(of_pose, rows, flange, sections, radius, options)
    best, *others = readings
    close = [o for o in others if o.start.misfit_mm < CLEARLY * max(best.start.misfit_mm, NEVER_MM)]
    if close:
        raise ConfigError(
            f"{table.path}: the profiles fit {best.words} (residual {best.start.misfit_mm:.3g} mm) no better than "
            f"{'; or '.join(o.words for o in close)}; say which it is: --flange, --eye-in-hand or --eye-to-hand"
        )
    moving = best.hand if best.measurement == ARTEFACT_IN_SCANNER else se3.inverse(best.hand)
    best = replace(best, start=find_start(moving, sections.circles, radius))
    said = check_diameter(moving, sections.circles, radius, best.start, table)
    obs = sphere_observations(best.hand, best.measurement, best.start, sections, radius, str(table.path))
    return UnderstoodTable(obs, (*_sentences(best, sections, columns, options), said))


def check_diameter(moving: np.ndarray, circles: Sequence[Circle], radius: float, start: ProfileStart, table: Table) -> str:
    """A sentence on the diameter that profiles alone say. Raises ConfigError if they contradict the stated radius (mm)."""
    own_radius, sigma = radius_by_profiles(moving, circles, radius, start)
    if abs(own_radius - radius) > SURE * sigma:
        raise ConfigError(
            f"{table.path}: the profiles say a diameter of {2 * own_radius:.2f} ± {4 * sigma:.2g} mm (k = 2), and --diameter "
            f"{2 * radius:g}; correct the diameter, or the unit of the profiles"
        )
    return f"the profiles alone say a diameter of {2 * own_radius:.2f} ± {4 * sigma:.2g} mm (k = 2)"


def _tried(
    table: Table, rows: np.ndarray, flange: PoseHeadings, sections: Sections, radius: float, options: TableOptions
) -> list[_Reading]:
    """Every reading that headings and options allow, the best first."""
    few = np.unique(np.linspace(0, len(rows) - 1, min(TRIED, len(rows))).round().astype(int))
    circles = [sections.circles[i] for i in few]
    keep = np.zeros(len(table), dtype=bool)
    keep[rows] = True
    part, found = table.rows(keep), []
    place = np.searchsorted(np.flatnonzero(keep), rows)
    measurements: list[Measurement] = [options.measurement] if options.measurement else [ARTEFACT_IN_SCANNER, TARGET_IN_BASE]
    for convention in conventions_of(flange, options.flange, "--flange"):
        group = in_units(replace(flange, convention=convention, alternatives=()), table, options)
        hand = group.transforms(part)[place]
        for measurement in measurements:
            moving = hand if measurement == ARTEFACT_IN_SCANNER else se3.inverse(hand)
            found.append(_Reading(group, hand, measurement, find_start(moving[few], circles, radius)))
    return sorted(found, key=lambda reading: reading.start.misfit_mm)


def _sentences(best: _Reading, sections: Sections, columns: ProfileTable, options: TableOptions) -> Iterator[str]:
    yield f"flange: {best.flange.described()}"
    yield f"line profiles: {', '.join(columns.points)}, numbered by {columns.number}; sphere of {options.diameter_mm:g} mm"
    none = f"; {sections.others} others show no sphere" if sections.others else ""
    yield f"{len(sections.rows)} profiles show the sphere, a point within {1e3 * sections.noise_mm:.3g} um{none}"
    yield f"{MEASUREMENTS[best.measurement]}; the profiles fit within {best.start.misfit_mm:.3g} mm (median)"
    yield "a profile's centre across the laser plane comes from the size of its circle: each measurement has a covariance of its own"


def sphere_observations(
    hand: np.ndarray, measurement: Measurement, start: ProfileStart, sections: Sections, radius: float, source: str
) -> Observations:
    """One sphere, seen in each profile. hand: (P, 4, 4) T_base_flange. Raises ConfigError if the poses do not decide the transform."""
    if start.ambiguous:
        raise ConfigError(
            f"{source}: two hand-eye transforms fit the profiles (residuals {start.misfit_mm:.3g} and {start.other_mm:.3g} mm); sweep "
            "across the sphere with four orientations and more, turned by 20° about two axes"
        )
    xyz, covariance = measured_centres(start, sections.circles, radius, sections.noise_mm)
    q, count = flange_coordinates(hand), len(xyz)
    artefact = Artefact("sphere", "", (1,), np.zeros((1, 3)), np.array([2 * radius]), 0.0)
    at_flange = start.T_hand_eye if measurement == ARTEFACT_IN_SCANNER else se3.transform(np.eye(3), start.sphere)
    noise = np.sqrt(np.median(np.einsum("mii->mi", covariance), axis=0))
    robot = arm_of_flange_poses("arm of flange poses", None, q)
    cell = Cell(robot, at_flange, (artefact,), (Station("s1", "sphere"),), noise_mm=noise, measurement=measurement)
    nothing = np.zeros(count, dtype=int)
    return Observations(cell, sections.numbers, nothing, q, np.arange(count), nothing, xyz, covariance=covariance)


def number_column(names: Sequence[str]) -> str | None:
    return next((n for n in names if n.strip().lower().replace(" ", "_") in NUMBER_WORDS), None)


def _rows_of(poses: Table, points: Table, columns: ProfileTable) -> np.ndarray:
    """The row of the poses (M,) for each row of the points. Raises ConfigError for a profile without a pose."""
    number = number_column(list(poses.columns))
    if number is None:
        raise ConfigError(
            f"{poses.path}:1: a table of poses beside profiles needs the number of each profile ({columns.number}); the header has: "
            f"{', '.join(poses.columns)}"
        )
    known = {n: i for i, n in enumerate(poses.integer(number).tolist())}
    wanted = points.integer(columns.number).tolist()
    missing = next((row for row, n in enumerate(wanted) if n not in known), None)
    if missing is not None:
        raise ConfigError(f"{points.where(missing, columns.number)}: profile {wanted[missing]} has no pose in {poses.path}; add it")
    return np.array([known[n] for n in wanted])
