"""The clouds of a folder, paired with the poses of a plan, and what is odd about them in sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from mbcacq.acquisition.collected import mistakes
from mbcacq.acquisition.collected.assignment import CloudAssignment, Slot, assign
from mbcacq.acquisition.collected.collected_run import CollectedPose
from mbcacq.acquisition.collected.found_cloud import FoundCloud, look_at
from mbcacq.acquisition.collected.placement_fit import PlacementFit
from mbcacq.design.simulated_observations import last_directions
from mbcacq.errors import ConfigError
from mbcacq.files.table import Column, TableSchema, read_table
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.routing import find_paths
from mbcacq.spheres.cloud_file import UNITS_MM
from mbcacq.spheres.cloud_files import SUFFIXES, CloudFormat, read_points
from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.found import SphereOptions
from mbcacq.workflow.joint_log import read_joint_log
from mbcacq.workflow.robot_program import plan_digest

MOST_CLOUDS = 20_000
TABLE = "poses.csv"
PROGRAM_TABLE = TableSchema(
    "the table of a robot program", (Column("pose", kind="integer"), Column("exposure", kind="integer"), Column("plan", kind="text"))
)
SAME_TIME_S = 1.0  # file times closer than this say nothing about an order


@dataclass(frozen=True)
class Sources:
    """Where the clouds of a session are.

    Attributes
    ----------
    clouds
        Folder of the clouds.
    form
        How the clouds are written; None: as the plan and the files say.
    by
        How the clouds are ordered: 'auto', 'number' (the last one in each name) or 'time' (when the file was written).
    joints
        Joint angles as the controller logged them, or None.
    table
        poses.csv of the robot program; None for the one among the clouds, if there is one.
    """

    clouds: Path
    form: CloudFormat | None = None
    by: str = "auto"
    joints: Path | None = None
    table: Path | None = None


@dataclass
class CloudSession:
    """A plan, its clouds, and what was found out about them."""

    loaded: LoadedPlan
    poses: list[PlannedPose]
    slots: list[Slot]
    form: CloudFormat
    clouds: list[FoundCloud]
    notes: list[tuple[int | None, str]] = field(default_factory=list)

    def note(self, text: str, left_out: int | None = None) -> None:
        """Say what is odd. left_out: number of the pose that is left out for it."""
        self.notes.append((left_out, text))

    def read(self, path: Path) -> np.ndarray:
        return read_points(path, self.form)

    def find(self, points: np.ndarray, artefact, **more):  # noqa: ANN001, ANN003, ANN202 (as find_spheres)
        return find_spheres(points, artefact, options=SphereOptions.for_noise(self.loaded.plan.scanner.noise_mm), **more)

    def look(self, path: Path, form: CloudFormat | None = None) -> FoundCloud:
        return look_at(path, self.read if form is None else partial(read_points, form=form), self.loaded.cell.artefacts, self.find)

    def again(self, cloud: FoundCloud, unit: str, axes: str) -> FoundCloud:
        """A cloud read in another unit, with other axes ('': as they are)."""
        return self.look(cloud.path, replace(self.form, unit=unit or self.form.unit, axes=axes or self.form.axes))


def read_session(
    loaded: LoadedPlan, poses: list[PlannedPose], sources: Sources, done: frozenset[int], progress: Callable[[str], None]
) -> CloudSession:
    """Everything read, and refused where it is wrong as a whole."""
    form = sources.form or CloudFormat()
    form.matrix()
    files = _files(sources)
    table = sources.table or (sources.clouds / TABLE if (sources.clouds / TABLE).is_file() else None)
    session = CloudSession(loaded, poses, _slots(loaded, poses, table, done, len(files)), form, [])
    for k, path in enumerate(files):
        if k % 10 == 0:
            progress(f"looking for balls in {len(files)} clouds, {100 * k // len(files)} % done")
        session.clouds.append(session.look(path))
    mistakes.refuse_unreadable(session.clouds)
    mistakes.refuse_other_unit(session.clouds, form.unit, list(UNITS_MM), session.again)
    mistakes.refuse_other_axes(loaded, poses, session.clouds, form.axes, session.again)
    return session


def _files(sources: Sources) -> list[Path]:
    """The clouds of the folder; tables and texts are clouds only where nothing else is."""
    folder = sources.clouds
    if not folder.is_dir():
        raise ConfigError(f"{folder}: is no folder; give the one that the scanner's program saved its clouds in")
    others = {TABLE, "readme.txt", *(path.name.lower() for path in (sources.joints, sources.table) if path is not None)}
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and p.name.lower() not in others and p.name[0] != ".")
    plainly = [p for p in found if p.suffix.lower() not in (".csv", ".txt")]
    found = plainly or found
    if not found:
        raise ConfigError(f"{folder}: holds no clouds ({', '.join(SUFFIXES)}); give the folder that the scanner's program saved them in")
    if len(found) > MOST_CLOUDS:
        raise ConfigError(f"{folder}: holds {len(found)} clouds, more than {MOST_CLOUDS}; give the folder of one session")
    return found


def _slots(loaded: LoadedPlan, poses: Sequence[PlannedPose], table: Path | None, done: frozenset[int], clouds: int) -> list[Slot]:
    """The expected clouds, in order. The program's table gives them; without it they are all exposures of the poses that are not done. If
    there are more clouds than that, those of the poses that are done are among them, and all poses count."""
    index = {pose.number: k for k, pose in enumerate(poses)}
    if table is None:
        every = [Slot(k, e) for k, pose in enumerate(poses) for e in range(pose.exposures)]
        missing = [slot for slot in every if poses[slot.pose].number not in done]
        return missing if clouds <= len(missing) else every
    rows = read_table(table, PROGRAM_TABLE)
    digests = set(rows.text("plan"))
    numbers, exposures = rows.integer("pose"), rows.integer("exposure")
    unknown = next((row for row, number in enumerate(numbers) if int(number) not in index), None)
    if digests != {plan_digest(loaded)}:
        raise ConfigError(
            f"{table}: the robot program was written for another plan, or for this one before it was changed; give the plan it was written "
            f"for, or write the program anew (plan {plan_digest(loaded)}, program {', '.join(sorted(digests))[:40]})"
        )
    if unknown is not None:
        raise ConfigError(
            f"{rows.where(unknown, 'pose')}: the plan has no pose {numbers[unknown]}; take the table written with the program"
        )
    return [Slot(index[int(number)], int(exposure)) for number, exposure in zip(numbers, exposures, strict=True)]


def paired(session: CloudSession, sources: Sources, done: frozenset[int]) -> list[CollectedPose]:
    """The clouds of each pose; what is odd goes into the session's notes."""
    clouds = _usable(session)
    fit, found, clouds = _best_order(session, clouds, sources.by)
    mistakes.refuse_other_session(session.loaded, fit, clouds, session.slots, found, session.form.axes)
    moved = list(mistakes.moved_artefacts(fit, clouds, session.slots, found.cloud))
    station_of = {p.number: p.station for p in session.poses}
    _note_pairs(session, clouds, found, {station_of[after] for _, after, _ in moved})
    for before, after, mm in moved:
        station = station_of[after]
        what = f"was moved by {mm:.1f} mm between pose {before} and pose {after}"
        session.note(f"the artefact at station '{station}' {what}; measure the station anew")
    logged = {}
    if sources.joints is not None:
        visited = [session.poses[k] for k in dict.fromkeys(slot.pose for slot in session.slots)]
        log = read_joint_log(sources.joints, session.loaded, visited)
        logged = log.q
        for text in log.notes:
            session.note(text)
    return _collected(session, clouds, found, logged, done)


def _usable(session: CloudSession) -> list[FoundCloud]:
    """Clouds that could be read, each content once."""
    seen: dict[str, FoundCloud] = {}
    for cloud in session.clouds:
        if not cloud.digest:
            session.note(f"{cloud.fault}; the cloud is left out")
        elif (same := seen.get(cloud.digest)) is not None:
            session.note(f"{cloud.name} is the same file as {same.name}, saved twice; it is left out")
        else:
            seen[cloud.digest] = cloud
    return list(seen.values())


def _best_order(session: CloudSession, clouds: list[FoundCloud], by: str) -> tuple[PlacementFit, CloudAssignment, list[FoundCloud]]:
    """Pair the clouds in the order of their names or of their times, whichever fits the plan."""
    orders: dict[str, list[FoundCloud]] = {}
    if by in ("auto", "number"):
        orders["number"] = sorted(clouds, key=_by_name)
    times = np.sort([cloud.written_s for cloud in clouds])
    if by == "time" or (by == "auto" and len(times) > 1 and np.median(np.diff(times)) > SAME_TIME_S):
        orders["time"] = sorted(clouds, key=lambda c: (c.written_s, _by_name(c)))
    tried = {}
    for name, order in orders.items():
        if tried and order == orders["number"]:
            continue
        fit = PlacementFit(session.loaded.cell, session.poses)
        tried[name] = (fit, assign(fit, order, session.slots), order)
    best = min(tried, key=lambda name: (tried[name][1].cost + 0.5 * len(tried[name][1].moved) / max(len(session.slots), 1), name))
    if len(tried) > 1 and best == "time":
        pair = next(((a, b) for a, b in pairwise(tried["number"][2]) if a.written_s > b.written_s + SAME_TIME_S), None)
        named = f" ({pair[0].name} was written after {pair[1].name})" if pair else ""
        session.note(f"the names of the clouds are not in the order in which they were taken{named}: renamed? Their times are used")
    return tried[best]


def _by_name(cloud: FoundCloud) -> tuple:
    if cloud.named_pose is not None:
        return (0, cloud.named_pose, cloud.named_exposure or 0, cloud.name)
    return (1, cloud.number if cloud.number is not None else -1, 0, cloud.name)


def _note_pairs(session: CloudSession, clouds: list[FoundCloud], found: CloudAssignment, moved: set[str]) -> None:
    """Missing, doubled, exchanged and stray clouds, and a session that ended early. moved: stations whose artefact was moved."""
    slots, poses = session.slots, session.poses
    for c, where in found.moved.items():
        own = next(s for s, k in enumerate(found.cloud) if k == c)
        shown = poses[slots[own].pose].number
        place = "" if where is None else f" stands where pose {poses[slots[where].pose].number} should, but"
        why = "exchanged or renamed?" if where is None else _why(slots[own].pose, slots[where].pose)
        session.note(f"{clouds[c].name}{place} shows pose {shown} ({why}); it is taken for pose {shown}")
    _note_strays(session, clouds, found, moved)
    for c in found.spare:
        session.note(f"{clouds[c].name} {_spare(session, found, c)}; it is left out")
    _note_missing(session, found)


def _note_strays(session: CloudSession, clouds: list[FoundCloud], found: CloudAssignment, moved: set[str]) -> None:
    """Clouds that do not show what their pose would."""
    poses = session.poses
    for slot, c in zip(session.slots, found.cloud, strict=True):
        if c is None or c in found.moved or poses[slot.pose].station in moved or np.isnan(found.distances[c]).any():
            continue
        off, k = found.distances[c, slot.pose], int(np.argmin(found.distances[c]))
        known = found.distances[c, k] < min(found.near_mm, mistakes.CLEARLY * off)
        if off > found.near_mm or (known and off > mistakes.MOVED_MM):
            other = f"it shows pose {poses[k].number} ({_why(k, slot.pose)})" if known else "it fits no pose"
            session.note(f"{clouds[c].name} is {off:.0f} mm off what pose {poses[slot.pose].number} would show; {other}")


def _note_missing(session: CloudSession, found: CloudAssignment) -> None:
    slots, poses = session.slots, session.poses
    missing = Counter(slot.pose for slot, c in zip(slots, found.cloud, strict=True) if c is None)
    wanted = Counter(slot.pose for slot in slots)
    last = max((slot.pose for slot, c in zip(slots, found.cloud, strict=True) if c is not None), default=-1)
    gone = [k for k in missing if missing[k] == wanted[k]]
    after = [k for k in gone if k > last]
    if len(after) > 1:
        ended = f"the session ended after pose {poses[last].number}: {len(after)} poses remain; write a program for them with --resume"
        session.note(ended)
    for k, count in missing.items():
        number = poses[k].number
        if count < wanted[k]:
            session.note(f"pose {number}: {count} of {wanted[k]} clouds are missing; it is taken from the others")
        elif k not in after or len(after) == 1:
            session.note(f"pose {number}: its cloud is missing, pose left out", number)


def _why(shown: int, wanted: int) -> str:
    """What may have happened to a cloud that shows another pose than it should."""
    return "taken late, after the arm had moved on?" if shown == wanted + 1 else "exchanged or renamed?"


def _spare(session: CloudSession, found: CloudAssignment, c: int) -> str:
    distances = found.distances[c]
    if np.isnan(distances).any():
        return "shows too few balls to say of which pose it is, and is one too many"
    k = int(np.argmin(distances))
    if distances[k] < 2 * found.near_mm:
        return f"shows pose {session.poses[k].number} once more than was asked for: taken twice?"
    return f"shows the artefact as no pose of the plan would (the nearest, {session.poses[k].number}, is {distances[k]:.0f} mm off)"


def _collected(
    session: CloudSession, clouds: list[FoundCloud], found: CloudAssignment, logged: dict[int, np.ndarray], done: frozenset[int]
) -> list[CollectedPose]:
    start = min(cloud.written_s for cloud in clouds) if clouds else 0.0
    direction = last_directions(session.loaded, session.poses, find_paths(session.loaded, session.poses)[0])
    out: list[CollectedPose] = []
    for k, pose in enumerate(session.poses):
        own = [clouds[c] for slot, c in zip(session.slots, found.cloud, strict=True) if c is not None and slot.pose == k]
        if own and pose.number not in done:
            q = logged.get(pose.number, pose.q)
            files = tuple(cloud.path for cloud in own)
            out.append(CollectedPose(pose, q, direction[k], files, min(c.written_s for c in own) - start))
    return out
