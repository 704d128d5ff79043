"""Simple mistakes in describing a recording of poses, each as the change that undoes it; balls taken for each other show by themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
from scipy.spatial.transform import Rotation

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.flange_poses import flange_coordinates, flange_transforms
from mbcacq.geometry.orientations import in_words, to_matrices, to_numbers
from mbcacq.model import shipped
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, TARGET_IN_BASE, Station
from mbcacq.model.observations import Observations
from mbcacq.quantities import in_degrees

FLANGE_ANGLES = ("ZYX", "xyz", "vector", "XYZ", "ZYZ")  # of the makers' conventions, those with three angles
_OTHER = {
    TARGET_IN_BASE: "the measured points taken in the scanner's frame (scanner on the flange: use measurement: artefact_in_scanner)",
    ARTEFACT_IN_SCANNER: "the scanner taken as fixed and the artefact on the flange (fixed scanner: use measurement: target_in_base)",
}

Change = Callable[[Observations], Observations]

AXES = "xyz"
MIRRORS = tuple((axis, np.where(np.arange(3) == k, -1.0, 1.0)) for k, axis in enumerate(AXES))
ORDERS = tuple((", ".join(AXES[k] for k in order), order) for order in permutations(range(3)) if order != (0, 1, 2))
QUARTERS = tuple((f"{90 * k:+d}°", k * np.pi / 2) for k in (1, -1, 2))
LONGEST_ROW_M = 20.0  # no row of an arm is shorter than this in mm and longer in m: rows below it may be metres
RADIANS = 7.0  # deg; a recording whose angles stay below may be in radians
INCH_MM = 25.4
MOST_SHIFTED = 5  # rows by which measurements may belong to another pose
LEAST_SHIFTED = 8  # poses that have a partner after a shift of the rows: fewer fit anything
LENGTHS = ("metres", 1e3), ("centimetres", 10.0), ("inches", INCH_MM)
NEAR_BALLS = 5.0  # times noise and uncertainty of the certificate: how well distances between balls must agree
MOST_TRIED = 20_000  # assignments of a ball; eight balls take a hundred


@dataclass(frozen=True)
class Misreading:
    """what: the change in words, to be read after 'with'; kind: of which several hold apart from it, they are the same mistake."""

    what: str
    kind: str
    change: Change


def hypotheses(o: Observations) -> Iterator[Misreading]:
    """Every simple change of convention that these observations allow."""
    yield from _units(o)
    if o.cell.robot.of_flange_poses:
        yield from _flange(o)
    else:
        yield from _robot_units(o)
        yield from _axes(o)
    yield from _measured(o)
    yield from _certified(o)
    yield from _frames(o)
    yield from _columns(o)


def other_arms(o: Observations) -> Iterator[Misreading]:
    """The links of each arm of the tool's own with as many axes, in place of those of the arm that is named."""
    named = o.cell.robot
    if named.of_flange_poses:
        return
    for robot in map(shipped.robot, shipped.robots()):
        if robot.n == named.n and robot.name != named.name:
            what = f"the links of {robot.name} in place of {named.name}"
            yield Misreading(what, "arm", lambda o, chain=robot.chain: _with_chain(o, lambda _: chain))


def _units(o: Observations) -> Iterator[Misreading]:
    for what, factor in (*LENGTHS, ("micrometres", 1e-3)):
        yield Misreading(f"the measured points read as {what}, not millimetres", "unit", lambda o, f=factor: replace(o, xyz=f * o.xyz))
        if np.any(o.cell.ball_centres):
            yield Misreading(
                f"the certified centres read as {what}, not millimetres", "unit", lambda o, f=factor: _centres(o, lambda c: f * c)
            )


def _robot_units(o: Observations) -> Iterator[Misreading]:
    if in_degrees(np.abs(o.q)).max() < RADIANS:
        what = "the angles read as radians, not degrees (are the columns q1_rad .. and not q1_deg ..?)"
        yield Misreading(what, "unit", lambda o: replace(o, q=in_degrees(o.q)))
    lengths = np.abs(np.concatenate([o.cell.robot.chain.a, o.cell.robot.chain.d]))
    if lengths.max() < LONGEST_ROW_M:
        what = "the robot's a and d read as metres, not millimetres"
        yield Misreading(what, "unit", lambda o: _with_chain(o, lambda c: replace(c, a=1e3 * c.a, d=1e3 * c.d)))
    alpha = np.abs(o.cell.robot.chain.alpha)
    if in_degrees(alpha).max() < RADIANS and alpha.any():
        what = "the robot's alpha and theta read as radians, not degrees"
        yield Misreading(what, "unit", lambda o: _with_chain(o, lambda c: replace(c, theta=in_degrees(c.theta), alpha=in_degrees(c.alpha))))


def _flange(o: Observations) -> Iterator[Misreading]:
    """Conventions of the poses of the flange: what each set of angles would be, had it been written in another."""
    yield Misreading(
        "the poses of the flange inverted (they are of the base in the flange)", "frame", lambda o: _other_flange(o, se3.inverse)
    )
    for read in ("ZYX", "xyz", "vector"):
        for meant in FLANGE_ANGLES:
            if meant != read:
                what = f"the orientations of the flange taken as {in_words(meant)}, where they were read as {in_words(read)}"
                yield Misreading(what, "orientation", lambda o, r=read, m=meant: _other_flange(o, lambda T: _reread(T, r, m)))
    for read in ("ZYX", "vector"):
        if in_degrees(np.abs(to_numbers(flange_transforms(o.q)[:, :3, :3], read))).max() < RADIANS:
            what = "the orientations of the flange read as radians, not degrees"
            yield Misreading(what, "unit", lambda o, r=read: _other_flange(o, lambda T: _in_degrees(T, r)))
    for what, factor in LENGTHS:
        scale = np.r_[factor, factor, factor, 1.0, 1.0, 1.0]
        yield Misreading(f"the places of the flange read as {what}, not millimetres", "unit", lambda o, f=scale: replace(o, q=f * o.q))


def _axes(o: Observations) -> Iterator[Misreading]:
    n, axes = o.cell.robot.n, o.cell.robot.axes
    for j, one in enumerate(np.eye(n)):
        yield Misreading(f"{axes[j]} reversed", "sign", lambda o, one=one: _angles(o, np.eye(n) - 2 * np.diag(one)))
        for turn, angle in QUARTERS:
            yield Misreading(f"{turn} added to {axes[j]}", "offset", lambda o, one=one, angle=angle: replace(o, q=o.q + angle * one))
    yield Misreading("all axes reversed", "sign", lambda o: _angles(o, -np.eye(n)))
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        yield Misreading(f"the columns of {axes[i]} and {axes[j]} exchanged", "order", lambda o, p=order: replace(o, q=o.q[:, p]))
    yield Misreading("the columns of the axes in reverse order", "order", lambda o: replace(o, q=o.q[:, ::-1]))
    for shift, word in ((1, "left"), (-1, "right")):
        what = f"the columns of the axes shifted by one to the {word}"
        yield Misreading(what, "order", lambda o, s=shift: replace(o, q=np.roll(o.q, -s, axis=1)))
    if n >= 3:
        for sign, word in ((1, "added to"), (-1, "subtracted from")):
            coupled = np.eye(n)
            coupled[2, 1] = sign
            yield Misreading(f"A2 {word} A3, which is counted from the horizontal", "coupling", lambda o, m=coupled: _angles(o, m))


def _measured(o: Observations) -> Iterator[Misreading]:
    for axis, mirror in MIRRORS:
        what = f"{axis} of the measured points reversed"
        yield Misreading(what, "handedness", lambda o, m=mirror: replace(o, xyz=o.xyz * m))
        if o.rotation is not None:
            both = f"{what}, in the orientation too"
            yield Misreading(both, "handedness", lambda o, m=mirror: _rotation(replace(o, xyz=o.xyz * m), lambda R: _mirrored(R, m)))
    for names, order in ORDERS:
        yield Misreading(f"the columns of the measured points read as {names}", "order", lambda o, p=order: replace(o, xyz=o.xyz[:, p]))
    if o.rotation is not None:
        yield Misreading("the orientation inverted", "orientation", lambda o: _rotation(o, lambda R: np.swapaxes(R, 1, 2)))
        yield Misreading("the orientation's quaternion read as x, y, z, w", "orientation", lambda o: _rotation(o, _w_last))
        for axis, mirror in MIRRORS:
            what = f"the orientation mirrored along {axis} (left-handed)"
            yield Misreading(what, "orientation", lambda o, m=mirror: _rotation(o, lambda R: _mirrored(R, m)))


def _certified(o: Observations) -> Iterator[Misreading]:
    if len(o.cell.ball_ids) < 2:
        return
    for (axis, mirror), extent in zip(MIRRORS, np.ptp(o.cell.ball_centres, axis=0), strict=True):
        if extent > 0:
            what = f"{axis} of the certified centres reversed"
            yield Misreading(what, "handedness", lambda o, m=mirror: _centres(o, lambda c: c * m))
    for names, order in ORDERS:
        what = f"the columns of the certified centres read as {names}"
        yield Misreading(what, "order", lambda o, p=order: _centres(o, lambda c: c[:, p]))


def _frames(o: Observations) -> Iterator[Misreading]:
    yield Misreading(_OTHER[o.cell.measurement], "frame", _other_measurement)
    if all(s.T_base_station is None for s in o.cell.stations):
        return
    yield Misreading("the declared station poses inverted", "frame", lambda o: _stations(o, se3.inverse))
    for turn, angle, k in [(turn, angle, 2) for turn, angle in QUARTERS] + [("180°", np.pi, 0), ("180°", np.pi, 1)]:
        turned = se3.exp(np.r_[np.zeros(3), angle * np.eye(3)[k]])
        what = f"the base turned by {turn} about its {AXES[k]}"
        yield Misreading(what, "frame", lambda o, T=turned: _stations(o, lambda X: T @ X))


def _columns(o: Observations) -> Iterator[Misreading]:
    for shift in (s for rows in range(1, MOST_SHIFTED + 1) for s in (rows, -rows)):
        if o.n_poses - abs(shift) >= LEAST_SHIFTED:
            further = f"pose {abs(shift)} rows {'on' if shift > 0 else 'back'}"
            pose = {1: "next pose", -1: "previous pose"}.get(shift, further)
            yield Misreading(f"each measurement belonging to the {pose}", "rows", lambda o, s=shift: _shifted(o, s))
    yield Misreading("the rows of the measurements in reverse order", "rows", lambda o: replace(o, q=o.q[::-1]))


def _angles(o: Observations, matrix: np.ndarray) -> Observations:
    return replace(o, q=o.q @ matrix.T)


def _with_chain(o: Observations, change: Callable[[Chain], Chain]) -> Observations:
    robot = replace(o.cell.robot, chain=change(o.cell.robot.chain))
    return replace(o, cell=replace(o.cell, robot=robot))


def _centres(o: Observations, change: Callable[[np.ndarray], np.ndarray]) -> Observations:
    artefacts = tuple(replace(a, centres=change(a.centres)) for a in o.cell.artefacts)
    return replace(o, cell=replace(o.cell, artefacts=artefacts))


def _stations(o: Observations, change: Callable[[np.ndarray], np.ndarray]) -> Observations:
    def changed(s: Station) -> Station:
        return s if s.T_base_station is None else replace(s, T_base_station=change(s.T_base_station))

    return replace(o, cell=replace(o.cell, stations=tuple(changed(s) for s in o.cell.stations)))


def _other_measurement(o: Observations) -> Observations:
    other = ARTEFACT_IN_SCANNER if o.cell.measurement == TARGET_IN_BASE else TARGET_IN_BASE
    return replace(o, cell=replace(o.cell, measurement=other))


def _other_flange(o: Observations, change: Callable[[np.ndarray], np.ndarray]) -> Observations:
    return replace(o, q=flange_coordinates(change(flange_transforms(o.q))))


def _reread(T: np.ndarray, read: str, meant: str) -> np.ndarray:
    """T (P, 4, 4) whose numbers, read in one convention, were meant in another."""
    numbers = to_numbers(T[:, :3, :3], read)
    return se3.transform(to_matrices(numbers, meant), T[:, :3, 3])


def _in_degrees(T: np.ndarray, read: str) -> np.ndarray:
    """T (P, 4, 4) whose angles were taken for degrees and are radians."""
    numbers = to_numbers(T[:, :3, :3], read)
    return se3.transform(to_matrices(in_degrees(numbers), read), T[:, :3, 3])


def _shifted(o: Observations, shift: int) -> Observations:
    """The angles of a pose some rows on or back for each measurement; poses at the end that have no partner are left out."""
    at = np.arange(o.n_poses) + shift
    inside = (at >= 0) & (at < o.n_poses)
    return replace(o, q=o.q[np.clip(at, 0, o.n_poses - 1)]).select(inside)


def _rotation(o: Observations, change: Callable[[np.ndarray], np.ndarray]) -> Observations:
    assert o.rotation is not None, "offered only if an orientation was measured"
    return replace(o, rotation=change(o.rotation))


def _mirrored(R: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """The reflection D of a rotation is D R D."""
    return mirror[:, None] * R * mirror


def _w_last(R: np.ndarray) -> np.ndarray:
    """The rotations (N, 3, 3) whose quaternions were read as w, x, y, z though they are x, y, z, w."""
    return Rotation.from_quat(np.roll(Rotation.from_matrix(R).as_quat(), 1, axis=1)).as_matrix()


def exchanged_balls(obs: Observations) -> str:
    """A sentence on balls whose numbers are exchanged, by the distances between the balls of each scan; '' if the numbers agree with
    them, or no exchange makes them agree."""
    measured = _mean_distances(obs)
    if measured is None:
        return ""
    certified = np.linalg.norm(obs.cell.ball_centres[:, None] - obs.cell.ball_centres[None], axis=2)
    noise = 0.02 if obs.cell.noise_mm is None else float(np.mean(obs.cell.noise_mm))
    agree = NEAR_BALLS * (noise + max(a.uncertainty_mm for a in obs.cell.artefacts))
    if not np.nanmax(np.abs(measured - certified)) > agree:
        return ""
    order = _matched(measured, certified, obs.cell.ball_artefact, agree)
    if order is None:
        return ""
    ids = obs.cell.ball_ids
    pairs = ", ".join(f"{ids[k]} is certified as {ids[as_]}" for k, as_ in enumerate(order) if as_ != k)
    return f"the numbers of balls are exchanged (by the distances between them, {pairs}); correct the certificate or the numbers"


def _matched(measured: np.ndarray, certified: np.ndarray, artefact: np.ndarray, agree: float) -> list[int] | None:
    """Which certified ball of its artefact each measured one is, so that all distances (K, K) agree within ``agree`` mm; None if there
    is no such assignment. Ball after ball is assigned, and taken back where a distance to the balls before it does not fit."""
    order: list[int] = []
    choices = [iter(np.flatnonzero(artefact == artefact[0]))]
    for _ in range(MOST_TRIED):
        k = len(order)
        if k == len(measured):
            return order
        chosen = next((int(c) for c in choices[-1] if c not in order and _fits(measured[k, :k], certified[c, order], agree)), None)
        if chosen is not None:
            order.append(chosen)
            choices.append(iter(np.flatnonzero(artefact == artefact[min(k + 1, len(measured) - 1)])))
        elif order:
            order.pop()
            choices.pop()
        else:
            return None
    return None


def _fits(measured: np.ndarray, certified: np.ndarray, agree: float) -> bool:
    """Whether the distances that were measured agree; NaN stands for one that was not."""
    return not np.any(np.abs(measured - certified) > agree)


def _mean_distances(obs: Observations) -> np.ndarray | None:
    """(K, K) mm mean distance of two balls over the scans that show both, NaN where none does; None of one ball a scan."""
    K = len(obs.cell.ball_ids)
    where = np.full((obs.n_poses, K, 3), np.nan)
    where[obs.pose, obs.ball] = obs.xyz
    apart = np.linalg.norm(where[:, :, None] - where[:, None], axis=3)
    seen = np.isfinite(apart)
    seen[:, np.arange(K), np.arange(K)] = False
    count = seen.sum(axis=0)
    if not count.any():
        return None
    return np.where(count > 0, np.where(seen, apart, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
