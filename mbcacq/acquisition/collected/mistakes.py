"""What goes wrong in a session that nobody supervises, recognised from the clouds of it: each mistake has a sentence of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np

from mbcacq.acquisition.collected.assignment import CloudAssignment, Slot, assign
from mbcacq.acquisition.collected.found_cloud import FoundCloud
from mbcacq.acquisition.collected.placement_fit import PlacementFit
from mbcacq.devices import ConfigError
from mbcacq.files.stated_unit import in_words
from mbcacq.geometry import se3
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.field_of_view import margin
from mbcacq.quantities import from_degrees, in_degrees

Look = Callable[[FoundCloud, str, str], FoundCloud]  # a cloud read once more: in another unit, with other axes
TRIED = 5  # clouds that a guess is tried with
MOST_OF = 0.6  # of the clouds
OF_THIS_PLAN = 0.8  # of the clouds: two plans for one cell share some views, and where few clouds are there a fit bends to them
OTHER_MOUNT_MM, OTHER_MOUNT_DEG = 25.0, 8.0  # a hand-eye from a drawing is better than this
EXCHANGED_MM, EXCHANGED_DEG = 25.0, 10.0  # how near to an exchange of axes the mount seems turned
CLEARLY = 0.4  # of the distance to its own pose: a cloud that is so near to another one was taken there
OWN_MM = 6.0  # from its own pose, once scanner and stations are known from all clouds: three times what a nominal arm misses by
MOVED_MM = 3.0  # of an artefact between two poses; less is an arm's own error


def refuse_unreadable(clouds: Sequence[FoundCloud]) -> None:
    """Raises ConfigError if no cloud can be read at all."""
    if clouds and all(cloud.fault and not cloud.digest for cloud in clouds):
        raise ConfigError(f"none of {len(clouds)} clouds can be read; the first: {clouds[0].fault}")


def refuse_other_unit(clouds: Sequence[FoundCloud], unit: str | None, units: Sequence[str], look: Look) -> None:
    """Raises ConfigError naming the unit in which the clouds show balls, where they show none in the given one."""
    blind = [cloud for cloud in clouds if cloud.digest and not len(cloud.ball)]
    if len(blind) < MOST_OF * len(clouds):
        return
    some = blind[:: max(1, len(blind) // TRIED)][:TRIED]
    for other in units:
        if other != unit and sum(len(look(cloud, other, "").ball) >= 1 for cloud in some) > len(some) / 2:
            named = in_words(other)
            raise ConfigError(
                f"the clouds are in {named}, not in {in_words(unit or 'mm')}: read as {named} they show the balls; add --unit {other} "
                "(scanner: options: unit in the plan)"
            )


def refuse_other_axes(loaded: LoadedPlan, poses: Sequence[PlannedPose], clouds: Sequence[FoundCloud], axes: str, look: Look) -> None:
    """Raises ConfigError naming the order and signs of axes with which the balls lie in the scanner's field of view."""
    seen = [cloud for cloud in clouds if cloud.identified]
    mirrored = [cloud for cloud in clouds if cloud.digest and "mirror" in cloud.fault]
    if len(mirrored) > MOST_OF * len(clouds):
        turned = _mirror(axes)
        seen = [cloud for cloud in (look(m, "", turned) for m in mirrored[:: max(1, len(mirrored) // TRIED)]) if cloud.identified]
        axes = turned
    elif not seen or _inside(loaded, seen, np.eye(3)) >= MOST_OF:
        return
    candidates = [M for M in rotations() if _inside(loaded, seen, M) >= MOST_OF]
    if not candidates:
        return
    fitting = min(candidates, key=lambda M: _miss(loaded, poses, seen, M))
    named = _named(fitting, axes)
    raise ConfigError(
        f"the clouds have other axes than the plan's scanner frame, whose z points to the scanner: the balls lie in its field of view "
        f"with --axes '{named}'; add that (scanner: options: axes in the plan)"
    )


def refuse_other_session(
    loaded: LoadedPlan, fit: PlacementFit, clouds: Sequence[FoundCloud], slots: Sequence[Slot], found: CloudAssignment, axes: str
) -> None:
    """Raises ConfigError if the clouds as a whole do not fit the plan: another mount of the scanner, or another plan."""
    known = [k for k, cloud in enumerate(clouds) if cloud.identified]
    if not known:
        return
    pose_of = {c: slot.pose for slot, c in zip(slots, found.cloud, strict=True) if c is not None}
    best = np.array([found.distances[c, pose_of[c]] if c in pose_of else np.inf for c in known])
    fitting = best < OWN_MM
    bumped = moved_poses(fit, moved_artefacts(fit, clouds, slots, found.cloud))
    if np.mean(fitting | [pose_of.get(c) in bumped for c in known]) >= OF_THIS_PLAN:
        _refuse_other_mount(loaded, fit, axes)
        return
    some = [clouds[k] for k in known]
    for axis, turned in _turned(loaded.cell.T_flange_scanner):
        other = PlacementFit(loaded.cell, fit.poses, turned)
        tried = assign(other, some, slots)
        turned_fitting = [tried.distances[c, slot.pose] < OWN_MM for slot, c in zip(slots, tried.cloud, strict=True) if c is not None]
        if sum(turned_fitting) >= OF_THIS_PLAN * len(some):
            raise ConfigError(
                f"the scanner sits otherwise on the flange than the plan's hand_eye says: turned by {axis:.0f}° about the flange's z "
                "axis the clouds fit; correct hand_eye, or mount it as planned"
            )
    raise ConfigError(
        f"{int(np.sum(~fitting))} of {len(known)} clouds do not show what the poses of this plan would: "
        "are they of another plan, another arm or another bracket?"
    )


def _refuse_exchanged(R: np.ndarray, axes: str) -> None:
    """R (3, 3): from the clouds' coordinates to those of the plan's scanner frame."""
    nearest = max(rotations(), key=lambda M: float(np.trace(M.T @ R)))
    if in_degrees(np.arccos(np.clip((np.trace(nearest.T @ R) - 1) / 2, -1, 1))) > EXCHANGED_DEG:
        return
    named = _named(nearest, axes)
    if nearest[2, 2] > 0.5:
        angle = in_degrees(np.arctan2(nearest[1, 0], nearest[0, 0]))
        raise ConfigError(
            f"the scanner is turned by {angle:.0f}° about its own axis against the plan's hand_eye: mounted otherwise on the flange? "
            f"Correct hand_eye, or, if it is the clouds that have other axes, add --axes '{named}'"
        )
    raise ConfigError(
        "the clouds have other axes than the plan's scanner frame, whose z points to the scanner: they fit the plan with "
        f"--axes '{named}'; add that (scanner: options: axes in the plan)"
    )


def _refuse_other_mount(loaded: LoadedPlan, fit: PlacementFit, axes: str) -> None:
    away = se3.inverse(loaded.cell.T_flange_scanner) @ fit.T_flange_scanner
    shift = fit.T_flange_scanner[:3, 3] - loaded.cell.T_flange_scanner[:3, 3]
    turn = in_degrees(np.arccos(np.clip((np.trace(away[:3, :3]) - 1) / 2, -1, 1)))
    if np.linalg.norm(shift) < EXCHANGED_MM and turn > 45:
        _refuse_exchanged(away[:3, :3], axes)
    if np.linalg.norm(shift) > OTHER_MOUNT_MM or turn > OTHER_MOUNT_DEG:
        at = ", ".join(f"{v:.0f}" for v in fit.T_flange_scanner[:3, 3])
        raise ConfigError(
            f"the scanner sits {np.linalg.norm(shift):.0f} mm and {turn:.0f}° from where the plan's hand_eye puts it: another flange or "
            f"bracket? The clouds say translation_mm [{at}]; correct hand_eye"
        )


def moved_artefacts(
    fit: PlacementFit, clouds: Sequence[FoundCloud], slots: Sequence[Slot], pairs: Sequence[int | None]
) -> Iterator[tuple[int, int, float]]:
    """For each station whose artefact moved: number of the last pose before, of the first one after, and by how many mm."""
    T_base_scanner = fit.cell.robot.chain.flange(np.array([p.q for p in fit.poses])) @ fit.T_flange_scanner
    for station, T_base_station in fit.stations.items():
        rows: list[tuple[int, np.ndarray]] = []
        for slot, c in zip(slots, pairs, strict=True):
            pose = fit.poses[slot.pose]
            if c is None or pose.station != station or not clouds[c].identified:
                continue
            artefact = fit.cell.artefact(pose.artefact)
            known = [k for k, b in enumerate(clouds[c].ball.tolist()) if b in artefact.ball_ids]
            if len(known) < len(clouds[c].ball):
                continue
            planned = se3.apply(T_base_station, artefact.centres[[artefact.ball_ids.index(b) for b in clouds[c].ball.tolist()]])
            rows.append((pose.number, np.mean(se3.apply(T_base_scanner[slot.pose], clouds[c].xyz) - planned, axis=0)))
        if len(rows) >= 4 and (split := _step([r for _, r in rows])) is not None:
            yield rows[split[0] - 1][0], rows[split[0]][0], split[1]


def moved_poses(fit: PlacementFit, moved: Iterable[tuple[int, int, float]]) -> set[int]:
    """Indices of the poses after their artefact was moved, as ``moved_artefacts`` gives it."""
    station_of = {pose.number: pose.station for pose in fit.poses}
    since = {station_of[after]: after for _, after, _ in moved}
    return {k for k, pose in enumerate(fit.poses) if pose.number >= since.get(pose.station, pose.number + 1)}


def _step(offsets: list[np.ndarray]) -> tuple[int, float] | None:
    """Where a series (k, 3) mm steps, and by how much; None if it does not."""
    values = np.array(offsets)

    def rest(k: int) -> float:
        return float(sum(np.sum((part - np.median(part, axis=0)) ** 2) for part in (values[:k], values[k:])))

    k = min(range(2, len(values) - 1), key=rest)
    step = float(np.linalg.norm(np.median(values[k:], axis=0) - np.median(values[:k], axis=0)))
    scatter = np.sqrt(rest(k) / len(values))
    return (k, step) if step > max(MOVED_MM, 2.5 * scatter) else None


def rotations() -> list[np.ndarray]:
    """The 24 rotations that exchange axes."""
    signed = (np.eye(3)[list(order)] * np.array(signs)[:, None] for order in permutations(range(3)) for signs in product((1, -1), repeat=3))
    return [M for M in signed if np.linalg.det(M) > 0]


def _inside(loaded: LoadedPlan, clouds: Sequence[FoundCloud], M: np.ndarray) -> float:
    """Share of the clouds whose balls lie in the field of view with other axes."""
    view = loaded.plan.scanner.field_of_view
    slack = 0.15 * (view.near_z_mm - view.far_z_mm)
    return float(np.mean([margin(view, cloud.xyz @ M.T).min() > -slack for cloud in clouds])) if clouds else 0.0


def _miss(loaded: LoadedPlan, poses: Sequence[PlannedPose], clouds: Sequence[FoundCloud], M: np.ndarray) -> float:
    """How badly (mm, median) the clouds fit their best poses with other axes."""
    fit = PlacementFit(loaded.cell, poses)
    turned = [replace(cloud, xyz=cloud.xyz @ M.T) for cloud in clouds]
    return float(np.median(np.min(fit.distances(turned), axis=1)))


def _mirror(axes: str) -> str:
    words = axes.split()
    return " ".join([words[0][1:] if words[0].startswith("-") else f"-{words[0].lstrip('+')}", *words[1:]])


def _named(M: np.ndarray, axes: str) -> str:
    """Axes as ``CloudFormat`` names them, of M after ``axes``."""
    words, out = axes.split(), []
    for row in M:
        column = int(np.argmax(np.abs(row)))
        word = words[column].lstrip("+")
        out.append(word if row[column] > 0 else word[1:] if word.startswith("-") else f"-{word}")
    return " ".join(out)


def _turned(T_flange_scanner: np.ndarray) -> Iterator[tuple[float, np.ndarray]]:
    """The scanner turned about the flange's z axis by the angles at which its bolts let it sit; the fit finds smaller ones by itself."""
    for angle in (90.0, 180.0, 270.0):
        c, s = np.cos(from_degrees(angle)), np.sin(from_degrees(angle))
        yield angle, se3.transform(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.zeros(3)) @ T_flange_scanner
