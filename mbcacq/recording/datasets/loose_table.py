"""One wide table without cell.yaml, as most hand-eye data are: a row has the pose of the flange and what was seen of the target.

Headings say what is what; where they allow more than one reading, each is tried on the data, and one is taken only where it alone fits.
Beside the observations come sentences that say how the table was understood.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np

from mbcacq.calibration.description import misdescribed, residual_mm
from mbcacq.errors import ConfigError
from mbcacq.files.clock import in_seconds
from mbcacq.files.table import Table, read_table
from mbcacq.geometry import se3
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, TARGET_IN_BASE, Artefact, Cell, Measurement, RobotModel, Station, arm_of_flange_poses
from mbcacq.model.joint_resolution import computed_by_the_arm
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets import covariances
from mbcacq.recording.datasets.columns import flange_group, groups, joint_angles, joint_columns, names_poses, unit_above
from mbcacq.recording.datasets.pose_columns import ANGLES, EULERS, LENGTHS, PoseHeadings, heading, named_convention, role
from mbcacq.recording.datasets.uncertified import with_estimated_centres

SUFFIXES = (".csv", ".txt", ".tsv")
CLEARLY = 3.0  # times the misfit of the best reading, below which another is as likely
NEVER_MM = 1e-3  # misfits below are rounding
LEAST_POSES = 4
NO_FIT_MM, NO_FIT = 1.0, 0.5  # residual, and its share of that of rows paired at random, from which no reading fits
SHUFFLES = 5
MOST_DOUBTED = 4  # readings in which a simple mistake is looked for
WRONG_ARM_MM = 15.0  # residual that no arm leaves as its maker draws it: they err by 0.5 to 5 mm
DOUBTFUL_MM = 0.5  # residual from which a simple mistake in the table is looked for; arms are off by less
MEASUREMENTS = {
    ARTEFACT_IN_SCANNER: "scanner on the flange (eye in hand)",
    TARGET_IN_BASE: "scanner fixed, target on the flange (eye to hand)",
}
COMPONENTS = {"x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz", *(c for names in EULERS for c in names)}
_BALL = re.compile(r"^([xyz])_?(\d+)$")


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """What the user says of a table; None: the headings or the data decide.

    flange, target: conventions of orientations (makers' names or words of ``mbcacq.geometry.orientations``). length ('mm', 'm') and angle
    ('deg', 'rad'): where headings say none. measurement: as in cell.yaml. flange_inverted, target_inverted: whether the base's pose in
    the flange stands in place of the flange's in the base, and the camera's in the target in place of the target's in the camera.
    columns: names of this program -> names in the file. robot: of joint angles. noise_mm: (3,) of one point. diameter_mm: of the sphere
    in line profiles. by_instrument: an instrument measured the points, though the arm's own kinematics give them to rounding.
    """

    flange: str | None = None
    target: str | None = None
    length: str | None = None
    angle: str | None = None
    measurement: Measurement | None = None
    flange_inverted: bool | None = None
    target_inverted: bool | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    robot: RobotModel | None = None
    noise_mm: tuple[float, float, float] | None = None
    diameter_mm: float | None = None
    by_instrument: bool = False


@dataclass(frozen=True)
class UnderstoodTable:
    """observations, and how the table was read: one sentence for each choice."""

    observations: Observations
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class TableReading:
    """One way to read a table. flange: columns of its pose, None of joint angles; targets: those of the target, or of its balls."""

    flange: PoseHeadings | None
    targets: tuple[PoseHeadings, ...]
    measurement: Measurement
    inverted: bool = False

    def differs(self, other: TableReading) -> str:
        """In words, what sets this reading apart from another."""
        parts = []
        if self.flange and other.flange and self.flange.convention != other.flange.convention:
            parts.append(f"the flange's {self.flange.described()}")
        if self.targets[0].convention != other.targets[0].convention:
            parts.append(f"the target's {self.targets[0].described()}")
        if self.inverted != other.inverted:
            parts.append("the camera's pose as the target sees it" if self.inverted else "the target's pose as the camera sees it")
        if self.measurement != other.measurement:
            parts.append(MEASUREMENTS[self.measurement])
        return " and ".join(parts)


def read_loose_table(path: Path, options: TableOptions | None = None) -> UnderstoodTable:
    """Read a table of at least ``LEAST_POSES`` rows. Raises ConfigError naming what is missing, or what the data cannot decide."""
    options = options or TableOptions()
    table = table_of(path, options)
    options = replace(options, length=options.length or unit_above(table))
    if len(table) < LEAST_POSES:
        raise ConfigError(f"{path}: {len(table)} rows; a hand-eye calibration needs at least {LEAST_POSES} poses, better 15 and more")
    return understood(table, options)


def table_of(path: Path, options: TableOptions) -> Table:
    """The table in a file, its columns by the names of this program where ``options`` say them."""
    names = {file: ours for ours, file in options.columns.items()}
    return read_table(path, names=names, headings=lambda cells: names_poses([names.get(cell, cell) for cell in cells]))


def understood(table: Table, options: TableOptions) -> UnderstoodTable:
    """The most likely reading of a table; see ``read_loose_table``."""
    readings = list(_readings(table, options))
    made = [(reading, _observations(table, reading, options)) for reading in readings]
    scored = sorted(((_misfit(obs), i) for i, (_, obs) in enumerate(made)), key=lambda pair: pair)
    (best, i), *others = scored
    reading, obs = made[i]
    if not np.isfinite(best):
        raise ConfigError(
            f"{table.path}: no reading of the columns fits the poses; check that flange and target belong together, row by row"
        )
    _refuse_unfitting([made[j][1] for misfit, j in scored if misfit < CLEARLY * best][:MOST_DOUBTED] or [obs], best, table)
    close = [made[j][0] for misfit, j in others if misfit < CLEARLY * max(best, NEVER_MM)]
    if close:
        asked = ", or ".join(dict.fromkeys(filter(None, (other.differs(reading) for other in close))))
        raise ConfigError(
            f"{table.path}: its columns can be read in several ways that fit alike (residual {best:.3g} mm); say which it is: --flange, "
            "--target, --eye-in-hand, --eye-to-hand, --target-inverted or --target-direct of mbcacq data new, or turn the flange by 15° "
            f"and more about several axes; the ways are {reading.differs(close[0])}, or {asked}"
        )
    if not options.by_instrument and (off := computed_by_the_arm(obs)) is not None:
        raise ConfigError(
            f"{table.path}: the points are where {obs.cell.robot.name} itself computes them from the joint angles, within {off:.3g} mm, "
            "which is rounding: a calibration learns nothing from them; give what an instrument measured, or say --measured if one did"
        )
    said = _sentences(obs, reading, options, best, [(made[j][0], misfit) for misfit, j in others])
    return UnderstoodTable(obs, (*said, *_unused(table, reading)))


def _refuse_unfitting(alike: Sequence[Observations], best_mm: float, table: Table) -> None:
    """Raise ConfigError where even the best reading does not fit, with the simple mistake that explains it, where there is one. alike: of
    the readings that fit best, the best first."""
    obs = alike[0]
    if obs.n_centres > 1 and not np.ptp(obs.xyz, axis=0).any():
        raise ConfigError(
            f"{table.path}: all {obs.n_centres} measurements are the same to the last digit, while the flange moves; check the columns of "
            "the target, and the order of numbers in matrices"
        )
    if best_mm < DOUBTFUL_MM:
        return
    if mistake := next(filter(None, map(misdescribed, alike)), ""):
        raise ConfigError(f"{table.path}: {mistake}; correct the table, or say how it is meant")
    if best_mm > WRONG_ARM_MM and joint_columns(table) and not obs.cell.robot.of_flange_poses:
        raise ConfigError(
            f"{table.path}: with {obs.cell.robot.name} the joint angles fit the measurements within {best_mm:.3g} mm only, where an arm "
            "errs by a few: check that it is this arm (--robot), and the units and directions of its angles"
        )
    rng = np.random.default_rng(0)
    paired_at_random = [_misfit(replace(obs, q=obs.q[rng.permutation(obs.n_poses)])) for _ in range(SHUFFLES)]
    if best_mm > max(NO_FIT_MM, NO_FIT * float(np.median(paired_at_random))):
        raise ConfigError(
            f"{table.path}: no reading fits better than {best_mm:.3g} mm (rows paired at random: "
            f"{np.median(paired_at_random):.3g} mm): the rows of flange and target do not belong together, or the columns "
            "are of something else"
        )


def _unused(table: Table, reading: TableReading) -> Iterator[str]:
    """A sentence on the columns that are not used, each with its reason."""
    used = {name for group in (reading.flange, *reading.targets) if group for name in (*group.names, *group.closing)} | table.taken
    joints, poses = joint_columns(table), {name: g for g in groups(table) for name in g.names}
    why: dict[str, list[str]] = {}
    for name in table.columns:
        if name in used:
            continue
        if name in joints:
            reason = "joint angles beside the flange's pose"
        elif name in poses:
            reason = "another pose or place"
        elif heading(name).component in COMPONENTS:
            reason = "no whole pose, or a second orientation of one"
        else:
            reason = "of no use here"
        why.setdefault(reason, []).append(name)
    if why:
        yield "not used: " + "; ".join(f"{', '.join(names)} ({reason})" for reason, names in why.items())


def _sentences(
    obs: Observations, reading: TableReading, options: TableOptions, best: float, others: Sequence[tuple[TableReading, float]]
) -> Iterator[str]:
    if reading.flange is not None:
        yield f"flange: {reading.flange.described()}"
    else:
        yield f"joint angles of {obs.cell.robot.name}"
    first = reading.targets[0]
    what = "target" if first.rotation else "sphere" if len(reading.targets) == 1 else "ball"
    for k, target in enumerate(reading.targets):
        yield f"{what}{f' {obs.cell.ball_ids[k]}' if len(reading.targets) > 1 else ''}: {target.described()}"
    if len(reading.targets) > 1:
        yield "the balls are of an artefact without certificate: their places are estimated, to the scale of the instrument"
    if reading.inverted:
        yield "the target's columns are the pose of the camera as the target sees it"
    if obs.phase is not None:
        counts = zip(*np.unique(obs.phase, return_counts=True), strict=True)
        yield f"phases: {', '.join(f'{count} {phase}' for phase, count in counts)}; poses of phase verification take no part in a fit"
    if obs.covariance is not None:
        yield "each measurement has a covariance of its own"
    stations = len(np.unique(obs.station))
    yield f"{MEASUREMENTS[reading.measurement]}; {obs.n_poses} poses at {stations} station(s), which fit within {best:.3g} mm"
    if first.rotation and options.measurement is None:
        other = next(words for key, words in MEASUREMENTS.items() if key != reading.measurement)
        yield f"the same data with the camera's pose as the target sees it (--target-inverted) would be: {other}"
    if others:
        nearest, misfit = others[0]
        yield f"next best reading: {nearest.differs(reading)}: {'no fit' if not np.isfinite(misfit) else f'{misfit:.3g} mm'}"


def _misfit(obs: Observations) -> float:
    try:
        return residual_mm(obs)
    except (ValueError, np.linalg.LinAlgError):
        return float("inf")


def _readings(table: Table, options: TableOptions) -> Iterator[TableReading]:
    flange = None if joint_columns(table) and options.robot else flange_group(table)
    if flange is None and options.robot is None:
        raise ConfigError(_no_flange(table))
    targets = _targets(table, flange)
    if not targets:
        raise ConfigError(
            f"{table.path}:1: no column says what was seen (the header has: {', '.join(table.columns)}); name the columns of the "
            "target's pose "
            "target_x_mm .. target_qz, of one sphere sphere_x_mm, sphere_y_mm, sphere_z_mm, of several x1_mm, y1_mm, z1_mm, x2_mm .."
        )
    flange = None if flange is None else directed(flange, options.flange_inverted, table, "flange")
    if options.target_inverted is not None or (options.measurement and targets[0].inverted is None):
        targets = (replace(targets[0], inverted=False), *targets[1:])  # said, or tried both ways below
    targets = (directed(targets[0], None, table, "target"), *targets[1:])
    conventions = [conventions_of(flange, options.flange, "--flange"), conventions_of(targets[0], options.target, "--target")]
    measurements: list[Measurement] = [options.measurement] if options.measurement else [ARTEFACT_IN_SCANNER, TARGET_IN_BASE]
    # Where the measurement is not known, an inverted target is the same equation as the other measurement: the headings are believed.
    both = options.measurement and targets[0].rotation and options.target_inverted is None
    inverted = (False, True) if both else (bool(options.target_inverted),)
    for (of_flange, of_target), (measurement, inverse) in product(product(*conventions), product(measurements, inverted)):
        hand = None if flange is None else in_units(replace(flange, convention=of_flange, alternatives=()), table, options)
        seen = (replace(targets[0], convention=of_target, alternatives=()), *targets[1:])
        yield TableReading(hand, tuple(in_units(t, table, options) for t in seen), measurement, inverse)


def _no_flange(table: Table) -> str:
    found = ", ".join(table.columns)
    if joint_columns(table):
        return (
            f"{table.path}: the table has joint angles and no pose of the flange; name the arm: mbcacq data new {table.path.name} "
            "--robot ROBOT, "
            "or write a cell.yaml"
        )
    return (
        f"{table.path}:1: no columns give the pose of the flange (the header has: {found}); name them flange_x_mm, flange_y_mm, "
        "flange_z_mm "
        "and a_deg, b_deg, c_deg (KUKA), w_deg, p_deg, r_deg (FANUC), rx_rad, ry_rad, rz_rad (UR), qw, qx, qy, qz, or r11 .. r33"
    )


def conventions_of(group: PoseHeadings | None, said: str | None, option: str) -> tuple[str, ...]:
    """The conventions that the orientation of a pose may have: the one that was said (by ``option``), or those that the headings allow."""
    if group is None or not group.rotation:
        return ("",)
    if said is None:
        return (group.convention, *group.alternatives)
    found = named_convention(said, option)
    return (found,)


def directed(group: PoseHeadings, inverted: bool | None, table: Table, of: str) -> PoseHeadings:
    """The pose with what was said of its direction, else by its name. Raises ConfigError where the name means either."""
    if inverted is None and group.inverted is None:
        raise ConfigError(
            f"{table.at_headings}: '{group.thing}' is the {of}'s pose to some, and its inverse to OpenCV; say which it is: "
            f"--{of}-direct or --{of}-inverted of mbcacq data new"
        )
    return group if inverted is None else replace(group, inverted=inverted)


def in_units(group: PoseHeadings, table: Table, options: TableOptions) -> PoseHeadings:
    """The pose with its units: of the headings, else as was said, else by the size of the numbers."""
    length = group.length or LENGTHS.get(options.length or "")
    angle = group.angle or ANGLES.get(options.angle or "")
    return replace(group, length=length, angle=angle).with_units(table)


def _targets(table: Table, flange: PoseHeadings | None) -> tuple[PoseHeadings, ...]:
    """The pose of a target, or the places of its balls."""
    left = [g for g in groups(table) if g != flange and role(g) != "flange"]
    poses = [g for g in left if g.rotation]
    if poses:
        named = [g for g in poses if role(g) == "target"]
        return ((named or poses)[0],)
    return (*left, *_numbered(table))


def _numbered(table: Table) -> list[PoseHeadings]:
    """Balls whose coordinates are x1, y1, z1, x2 .."""
    parts: dict[int, dict[str, tuple[str, str]]] = {}
    for name in table.columns:
        part = heading(name)
        if found := _BALL.match(part.component):
            parts.setdefault(int(found[2]), {})[found[1]] = name, part.unit
    whole = {ball: of for ball, of in sorted(parts.items()) if len(of) == len("xyz")}
    return [PoseHeadings(str(ball), tuple(of[c][0] for c in "xyz"), length=LENGTHS.get(of["x"][1])) for ball, of in whole.items()]


def _observations(table: Table, reading: TableReading, options: TableOptions) -> Observations:
    balls = _ball_ids(reading.targets)
    pose, ball, xyz, rotation, covariance = [], [], [], [], []
    for number, target in enumerate(reading.targets):
        seen = np.array([all(table.columns[n][row].strip() for n in target.names) for row in range(len(table))], dtype=bool)
        part = table.rows(seen)
        T = target.transforms(part)
        T = se3.inverse(T) if reading.inverted else T
        pose.append(np.flatnonzero(seen))
        ball.append(np.full(len(part), number))
        xyz.append(T[:, :3, 3])
        rotation.append(T[:, :3, :3])
        stated = covariances.read(part, 6 if target.rotation else 3) if len(reading.targets) == 1 else None
        covariance += [] if stated is None else [stated]
        table.taken |= part.taken
    at = np.concatenate(pose)
    order = np.argsort(at, kind="stable")
    certified = len(balls) == 1
    centres = np.zeros((1, 3)) if certified else np.full((len(balls), 3), np.nan)
    artefact = Artefact("target", "", balls, centres, np.zeros(len(balls)), 0.0 if certified else 1.0, certified=certified)
    names = [name.strip() for name in table.text("station")] if table.has(["station"]) else ["s1"] * len(table)
    index = {name: i for i, name in enumerate(dict.fromkeys(names))}
    robot, q = _arm(table, reading, options)
    cell = Cell(
        robot,
        np.eye(4),
        (artefact,),
        tuple(Station(name, "target") for name in index),
        noise_mm=None if options.noise_mm is None else np.array(options.noise_mm),
        measurement=reading.measurement,
    )
    obs = Observations(
        cell=cell,
        pose_id=np.arange(1, len(table) + 1),
        station=np.array([index[name] for name in names]),
        q=q,
        pose=at[order],
        ball=np.concatenate(ball)[order],
        xyz=np.concatenate(xyz)[order],
        rotation=np.concatenate(rotation)[order] if reading.targets[0].rotation else None,
        covariance=np.concatenate(covariance)[order] if covariance else None,
        phase=np.array([cell.strip() for cell in table.text("phase")]) if table.has(["phase"]) else None,
        time_s=in_seconds(table.time("time_s")) if table.has(["time_s"]) else None,
    )
    return with_estimated_centres(_with_stated_noise(obs), str(table.path))


def _with_stated_noise(obs: Observations) -> Observations:
    """The noise of the instrument as a whole, where each measurement states its own: rms of these."""
    if obs.covariance is None:
        return obs
    sigma = np.sqrt(np.einsum("mii->mi", obs.covariance).mean(axis=0))
    turn = float(np.sqrt(np.mean(sigma[3:] ** 2))) if len(sigma) > len("xyz") else None
    return replace(obs, cell=replace(obs.cell, noise_mm=sigma[:3], noise_rad=turn))


def _ball_ids(targets: Sequence[PoseHeadings]) -> tuple[int, ...]:
    """Numbers of the balls: those in the headings where all have one and no two the same, else 1, 2, 3 .."""
    if len(targets) == 1:
        return (1,)
    found = [re.search(r"(\d+)$", t.thing) for t in targets]
    ids = [int(m[1]) for m in found if m]
    return tuple(ids) if len(set(ids)) == len(targets) else tuple(range(1, len(targets) + 1))


def _arm(table: Table, reading: TableReading, options: TableOptions) -> tuple[RobotModel, np.ndarray]:
    if reading.flange is not None:
        q = reading.flange.coordinates(table)
        return arm_of_flange_poses("arm of flange poses", None, q), q
    assert options.robot is not None, "refused before"
    columns = joint_columns(table)
    if len(columns) != options.robot.n:
        raise ConfigError(
            f"{table.path}:1: {len(columns)} columns of joint angles, and {options.robot.name} has {options.robot.n} axes (the header has: "
            f"{', '.join(table.columns)}); name them q1_deg, q2_deg .., or say which they are: --column q1_deg=NAME"
        )
    return options.robot, joint_angles(table, columns, options.angle)
