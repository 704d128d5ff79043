"""Smooth functions of posture for what a calibrated arm does beyond its geometry: the discrepancy of a calibration.

Every group is a random effect. The groups are each joint's error as a function of its own angle, one group for each number of periods a
turn, of the torque about it and of the direction from which it arrived. Functions of more periods a turn and of the other joints' angles
are added if the evidence asks for them. Sizes begin large and are estimated with the noise (Kennedy and O'Hagan 2001 call what they stand
for model discrepancy); a group that nothing asks for shrinks to nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect import Missing
from mbcacq.effects.effect_term import SMOOTH, EffectTerm
from mbcacq.effects.functions import Column, DescribedPart, Product, cosine, linear, of, sine, times
from mbcacq.effects.kinds import mount_clearance
from mbcacq.quantities import DEGREE


@dataclass(frozen=True, kw_only=True)
class DiscrepancyOptions:
    """Which functions stand for the discrepancy, and how large they are where the estimation of their sizes begins."""

    orders: int = 4  # periods a turn of a joint's own error: eccentric wheels, bent shafts
    fastest: int = 32  # of its gears' stages, which are tried where these do not do: faster meshes are for names, not for smooth functions
    start_rad: float = 1e-3  # five times a bad gear's error, ten times the wind-up of an elastic joint at its largest torque
    mesh_rad: float = 1e-4  # of the teeth of a wheel
    order_sigma: float = 0.1  # of the order of a mesh that the largest share of a joint's errors follows
    start_mm: float = 0.3  # the play of a mount that was not tightened
    least_moment: float = 0.5  # N m, below which nothing gives way
    direction_start_rad: float = 3e-4  # half of a worn gear's lost motion
    taken_up_rad: float = 0.5 * DEGREE  # a movement after which lost motion is as after any longer one
    bent: float = 0.3  # share of a wind-up that is not proportional to the torque
    least_travel_rad: float = 0.02  # joints that move by less show nothing of their own
    mm_per_rad: float = 300.0  # a prismatic joint errs by so many mm where a revolute one of a usual arm errs by one rad
    guide_functions: int = 6  # half waves over the travel of a guide, whose rails are a few metres long
    guide_rad: float = 3e-4  # of its rails' yaw, pitch and roll: as far as 0.3 mm over the length of a carriage
    bearing_orders: int = 2  # periods a turn by which the axis of a turntable wanders: eccentric, and oval
    least_torque: float = 0.02  # of the largest torque's range, below which the torque about a joint says nothing
    wander_rad: float = 1e-4  # ten times a joint's repeatability
    wander_functions: int = 60  # cosines over the order of the poses, and no more than half of these: one a pair of poses
    wander_poses: int = 1200  # of longer recordings so many cosines show nothing that fewer than twenty poses share


OPTIONS = DiscrepancyOptions()
WANDER, ORDER = "wander", "order"
NEAR_MOUNT = 3  # joints whose angles a hose or a cable at the mount feels
BENT = {"softening": 2.0, "stiffening": 1 / 3}  # powers of a torque: teeth that lift off, and that touch over more of their width


def own_errors(here: Covariates) -> list[EffectTerm]:
    """Groups of each joint by its own angle, torque and direction.

    Parameters
    ----------
    here : Covariates
        Covariates of the recording to be calibrated.

    Returns
    -------
    list of EffectTerm
        Terms that displace one joint each, in rad; ``sigma`` is where the estimation of their size begins.
    """
    found: list[EffectTerm] = []
    loaded = _loaded(here.gravity_torque)
    torque = _recorded(here, "tau")
    for j in _moving(here):
        if j in here.obs.cell.robot.chain.sliding:
            found += _guide(here, j)
        else:
            found += _by_own_angle(here, j, range(1, OPTIONS.orders + 1))
        if j < here.obs.cell.robot.chain.floor:
            found += _bearing(here, j)
        if j in loaded:
            found += _by_torque(here, j, f"gravity_torque_{here.tags[j]}")
        if torque is not None and j in _loaded(torque):
            found += _by_torque(here, j, f"tau{here.tags[j]}")
        found += _by_arrival(here, j)
    return found


def gear_stages(here: Covariates) -> list[EffectTerm]:
    """Groups of each joint by its own angle, of more periods a turn: the wheels of its gear."""
    return [t for j in _turning(here) for t in _by_own_angle(here, j, range(OPTIONS.orders + 1, OPTIONS.fastest + 1))]


def mesh(here: Covariates, j: int, order: float) -> EffectTerm:
    """The group of joint j by one order of its own angle, and by the derivative of that by the order, which is not exactly known. It has
    many periods in the visited angles, and goes on beyond them."""
    name = f"q{here.tags[j]}"
    once = sine(name, order), cosine(name, order)
    columns = (*once, *(times(_centred(here, name), column) for column in once))
    sigma = OPTIONS.mesh_rad * np.repeat([1.0, OPTIONS.order_sigma], 2)
    return _term(here, j, name, columns, sigma, hyper={ORDER: order})


def couplings(here: Covariates) -> list[EffectTerm]:
    """Groups of each joint by the angles of the others, linear: wrists whose axes drive each other, scales, bent links."""
    moving = _turning(here)
    out = []
    for j in moving:
        others = [f"q{here.tags[i]}" for i in moving if i != j]
        if others:
            columns = tuple(_centred(here, name) for name in others)
            out.append(_term(here, j, "+".join(others), columns, np.full(len(columns), OPTIONS.start_rad)))
    return out


def pairs(here: Covariates) -> list[EffectTerm]:
    """Groups of each joint by products of sines and cosines of two angles, one group for each two."""
    moving = _turning(here)
    out = []
    for name, columns in _products(here, moving):
        sigma = np.full(len(columns), OPTIONS.start_rad / 3)
        out += [_term(here, j, name, columns, sigma) for j in moving]
    return out


def hoses(here: Covariates) -> list[EffectTerm]:
    """Groups of the mount by products of two wrist angles, one group for each two: a hose or a cable pulls at it."""
    each = _products(here, _turning(here)[-NEAR_MOUNT:])
    return [_frame(here, "mount", here.n, name, [(c, f) for c in (3, 4, 5) for f in columns]) for name, columns in each]


def _products(here: Covariates, joints: Sequence[int]) -> Iterator[tuple[str, tuple[Column, ...]]]:
    for a, b in combinations([f"q{here.tags[j]}" for j in joints], 2):
        yield f"{a}*{b}", tuple(times(x(a, 1), y(b, 1)) for x in (sine, cosine) for y in (sine, cosine))


def structure(here: Covariates) -> list[EffectTerm]:
    """Groups of the base and of each link, which turn by the moment of the weight behind them across the axis of the joint that follows;
    and of the mount by gravity in its axes: it gives way, or has clearances that gravity closes."""
    n, out = here.n, list[EffectTerm]()
    for i in range(n):
        turned = [
            (3 + c, linear(name, 1 / largest))
            for c, name in enumerate(f"gravity_moment_{here.frame_tags[i]}_{axis}" for axis in "xy")
            if (largest := float(np.abs(here.value(name)).max())) > OPTIONS.least_moment
        ]
        if turned:
            out.append(_frame(here, here.frames[i], i, f"gravity_moment_{here.frame_tags[i]}", turned))
    along = [f"gravity_direction_{here.tags[-1]}_{axis}" for axis in "xyz"]
    sides: list[tuple[str, list[Column]]] = [("gravity_direction", [linear(name) for name in along])]
    sides += [(name, [of(name, "sign")]) for name in along if np.ptp(np.sign(here.value(name))) > 0]
    return out + [_frame(here, "mount", n, on, [(c, f) for c in range(6) for f in functions]) for on, functions in sides]


def clearances(here: Context) -> list[EffectTerm]:
    """Groups of the mount by its seat, for each line along which gravity may close a clearance and each place to fall."""
    out = []
    for azimuth, elevation in mount_clearance.lines_of_residual(here):
        name = f"gravity_along_{here.tags[-1]}_{azimuth}_{elevation}"
        for at in mount_clearance.places_to_fall(here.value(name)):
            seat = of(name, "sigmoid", at, mount_clearance.AT_ONCE)
            out.append(_frame(here, "mount", here.n, name, [(c, seat) for c in range(6)], hyper={"falls_at": at}))
    return out


FURTHER = (structure, clearances, hoses, gear_stages, couplings, pairs)  # kinds, in the order in which they are tried


def wander(here: Covariates) -> list[EffectTerm]:
    """Groups of each joint by the order of the poses: errors that the poses after one another share, of gears that warm up and of drives
    that hunt slowly.

    Cosines of k half periods over all poses have sizes that fall as 1/k, as those of a random walk do.
    """
    last = here.obs.n_poses - 1
    k = np.arange(1, min(OPTIONS.wander_functions, here.obs.n_poses // 2) + 1)
    columns = [of("pose", "cosine", 0.0, float(last), float(each)) for each in k]
    return [_term(here, j, "pose", columns, OPTIONS.wander_rad / k, WANDER) for j in range(here.n)] if len(k) else []


def _moving(here: Covariates) -> list[int]:
    unit = here.obs.cell.robot.chain.by_kind(1.0, OPTIONS.mm_per_rad)
    return [int(j) for j in np.flatnonzero(np.ptp(here.obs.q, axis=0) > OPTIONS.least_travel_rad * unit)]


def _turning(here: Covariates) -> list[int]:
    return [j for j in _moving(here) if j not in here.obs.cell.robot.chain.sliding]


def _guide(here: Covariates, j: int) -> list[EffectTerm]:
    """What a prismatic joint carries, displaced and turned by smooth functions of its position: straightness, scale, yaw, pitch, roll."""
    name = here.position(j)
    low, high = float(here.value(name).min()), float(here.value(name).max())
    k = np.arange(1, OPTIONS.guide_functions + 1)
    columns = [of(name, "cosine", low, high, float(each)) for each in k]
    return _behind(here, j, columns, 1.0 / k, OPTIONS.guide_rad)


def _bearing(here: Covariates, j: int) -> list[EffectTerm]:
    """What the axis of a turntable carries, displaced and turned with its angle: a bearing that is eccentric, and a table that wobbles."""
    name, k = here.position(j), np.repeat(np.arange(1, OPTIONS.bearing_orders + 1), 2)
    columns = [f(name, int(each)) for each, f in zip(k, (sine, cosine) * OPTIONS.bearing_orders, strict=True)]
    return _behind(here, j, columns, 1.0 / k, OPTIONS.guide_rad)


def _behind(here: Covariates, j: int, columns: Sequence[Column], share: np.ndarray, size_rad: float) -> list[EffectTerm]:
    """Two groups of the link behind a joint, of displacements and of rotations, each of sizes in proportion to ``share``."""
    out, zero, f = list[EffectTerm](), ((),) * (3 * len(columns)), len(columns)
    for first, size, unit in ((0, OPTIONS.start_mm, "mm"), (3, size_rad, "rad")):
        parts = [DescribedPart("frame", j + 1, first + c, (*zero[: c * f], *columns, *zero[(c + 1) * f :])) for c in range(3)]
        name, variant = here.position(j), f"{SMOOTH} {unit}"
        sigma = size * np.tile(share, 3)
        out.append(
            EffectTerm.of_group(here, (here.frames[j + 1],), name, parts, sigma, (unit,) * len(sigma), variant=variant, clamped=(name,))
        )
    return out


def _loaded(torque: np.ndarray) -> set[int]:
    travel = np.ptp(torque, axis=0)
    return set(np.flatnonzero(travel > OPTIONS.least_torque * travel.max() + 1e-9).tolist())


def _recorded(here: Covariates, kind: str) -> np.ndarray | None:
    """(P, n) of what is recorded of the joints; None where it is not."""
    try:
        return np.stack([here.value(f"{kind}{j + 1}") for j in range(here.n)], axis=1)
    except Missing:
        return None


def _by_own_angle(here: Covariates, j: int, orders: Iterable[int]) -> list[EffectTerm]:
    """One group for each number of periods a turn: a wheel has one, and a size for all would spread over the others. Outside of the angles
    that were visited they fade (``EffectTerm.fades``)."""
    name = f"q{here.tags[j]}"
    return [_term(here, j, name, (sine(name, k), cosine(name, k)), np.full(2, OPTIONS.start_rad / k), f"order {k}") for k in orders]


def _by_torque(here: Covariates, j: int, name: str) -> list[EffectTerm]:
    """Wind-up by a torque, which goes on beyond the torques that were there; and the parts of it that are not proportional, which do not:
    powers of the torque less their regressions on it."""
    torque = here.value(name)
    largest = float(np.abs(torque).max())
    start = np.array([OPTIONS.start_rad])
    out = [_term(here, j, name, (linear(name, 1 / largest),), start)]
    for variant, power in BENT.items():
        bent = np.sign(torque) * np.abs(torque / largest) ** power
        slope = float(bent @ torque / max(torque @ torque, 1e-300))
        curve = (*of(name, "signed_power", power, factor=largest**-power), *linear(name, -slope))
        out.append(_term(here, j, name, (curve,), OPTIONS.bent * start, variant, clamped=(name,)))
    return out


def _by_arrival(here: Covariates, j: int) -> list[EffectTerm]:
    """Lost motion by the recorded direction of arrival; where none is recorded, by the way from the pose measured before."""
    taken_up = float(OPTIONS.taken_up_rad * here.obs.cell.robot.chain.by_kind(1.0, OPTIONS.mm_per_rad)[j])
    direction, movement = f"direction_{j + 1}", f"movement_{j + 1}"
    for kind, column in (("direction_", of(direction, "sign")), ("movement_", of(movement, "clip", taken_up, factor=1 / taken_up))):
        values = _recorded(here, kind)
        if values is not None and np.ptp(np.sign(values[:, j])) > 0:
            return [_term(here, j, f"{kind}{j + 1}", (column,), np.array([OPTIONS.direction_start_rad]))]
    return []


def _centred(here: Covariates, name: str) -> Column:
    middle = float(np.mean(here.value(name)))
    return (*linear(name), Product(-middle))


def _frame(here: Covariates, location: str, frame: int, depends_on: str, moved: Sequence[tuple[int, Column]], **fields: Any) -> EffectTerm:
    """One frame by functions, each of which moves one of its components."""
    zero: tuple[Column, ...] = ((),) * len(moved)
    parts = [DescribedPart("frame", frame, c, (*zero[:k], column, *zero[k + 1 :])) for k, (c, column) in enumerate(moved)]
    sigma = np.array([OPTIONS.start_rad if c >= 3 else OPTIONS.start_mm for c, _ in moved])
    units = tuple("rad" if c >= 3 else "mm" for c, _ in moved)
    return EffectTerm.of_group(here, (location,), depends_on, parts, sigma, units, variant=SMOOTH, **fields)


def _term(
    here: Covariates, j: int, depends_on: str, columns: Sequence[Column], sigma: np.ndarray, variant: str = SMOOTH, **fields: Any
) -> EffectTerm:
    """One joint by functions; sigma in rad."""
    parts, slides = (DescribedPart("joint", j, 0, tuple(columns)),), j in here.obs.cell.robot.chain.sliding
    sigma, units = sigma * (OPTIONS.mm_per_rad if slides else 1.0), ("mm" if slides else "rad",) * len(columns)
    return EffectTerm.of_group(here, (here.axes[j],), depends_on, parts, sigma, units, variant=variant, **fields)
