"""Groups of basis functions for what no effect of the catalogue describes, written down so that they can be kept.

A group acts at one location and is a function of one covariate. Angles enter by sines and cosines of whole orders, so a group means the
same a turn further on. Outside of where it was learnt a group fades to nothing (``EffectTerm.fades``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect import JOINTS
from mbcacq.effects.effect_term import COMMON_PATTERN, GIVES_WAY, EffectTerm
from mbcacq.effects.functions import INCIDENCE, Column, DescribedPart, Product, cosine, linear, of, of_second_degree, sine
from mbcacq.effects.learnt_range import is_angle
from mbcacq.quantities import from_degrees

DEVIATION = "deviation"


@dataclass(frozen=True, kw_only=True)
class UnmodelledOptions:
    """Tuning of the groups, with reasons; ``benchmarks/real_arms.py transfer`` measures all of it together."""

    own_order: int = 60  # periods a turn of a joint's own error: encoders and gear meshes of the open recordings end below
    other_order: int = 4  # of what a joint's angle does elsewhere: bearings are slow
    bearing_order: int = 2  # of the frame behind a joint by its angle: an axis that leans, and its oval bearing
    middle_order: float = 25.0  # from which the prior of an order falls: errors of encoders were found at 8 to 30
    slow_order: float = 5.0  # below which it falls: slow orders trade with geometry and gravity, and extrapolate worst
    many_poses: int = 350  # fewer do not determine orders above ``few_order``
    few_order: int = 9
    movement_deg: tuple[float, ...] = (0.1, 0.5, 2.0, 10.0, 40.0)  # after which what a movement leaves behind is as after any longer one
    movement_size: float = 0.1  # mrad: lost motion of a gearbox
    clock_functions: int = 6  # cosines over the duration of the recording
    drift_mm: float = 0.03  # of an instrument beside the arm, or of the base before it; a thousandth of it in rad
    orientation_rad: float = 1e-4  # bias of a measured orientation, for a line of sight that turns by one rad
    compliance_rad_per_Nm: float = 4.5e-5  # thirty times a typical gearbox's: no joint is softer
    tilt_rad_per_Nm: float = 3e-6  # of a link or a pedestal
    slow_deviation_rad: float = 3e-5  # orders 1 and 2 of a joint beside a common pattern: a typical error of a gear
    open_deviation_rad: float = 1e-4  # of orders below ``slow_order`` while a pattern is sought: an axis' eccentricity is that large
    deviation_rad: float = 1e-5  # of each further order; the size of both together is estimated for each joint
    smallest: float = 1e-4  # of a group's prior size: it is dropped below
    largest: float = 10.0  # times a group's prior size: no group is believed to be larger
    ending: tuple[int, float] = (60, 0.1)  # of the fixed point of sizes; noise and coefficients are found anew by thousands of poses


OPTIONS = UnmodelledOptions()


def order_weight(order: np.ndarray) -> np.ndarray:
    """Relative prior sigma of each order: little where it is slow, and falling where it is fast."""
    return order**2 / (order**2 + OPTIONS.slow_order**2) / (1 + (order / OPTIONS.middle_order) ** 4)


def group(here: Covariates, location: str, covariate: str) -> EffectTerm | None:
    """The group at a location (A1.., link1.., base, mount, target, the only station) by a covariate. It is the angle of a joint, its
    movement from the pose before, a gravity torque, the order of the poses, or the incidence on the target. None if there is none.
    """
    keys = keys_of(here, location)
    if not keys:
        return None
    if covariate.startswith("gravity_torque_"):
        return _by_gravity(here, location, covariate, keys)
    columns, weight = _functions(here, location, covariate)
    return _grown(here, location, covariate, keys, columns, weight) if columns else None


def everywhere(here: Covariates) -> list[EffectTerm]:
    """Groups for a recording of many poses. Every joint has groups by its own angle, by its movement from the pose before and by gravity.
    The links have groups by the weight behind them, and by the angle of the joint before them. An instrument beside the arm has groups by
    the order of the poses, and the orientation that it measures by the line of sight.
    """
    n, torque = here.n, here.gravity_torque
    slides = here.obs.cell.robot.chain.sliding
    moving = [i for i in range(n) if np.ptp(here.obs.q[:, i]) > 0.02 and i not in slides]
    found = [group(here, here.axes[i], f"q{here.tags[i]}") for i in moving]
    if here.obs.movement is not None:
        found += [group(here, here.axes[i], f"movement_{here.tags[i]}") for i in moving]
    loaded = [i for i in range(n) if np.ptp(torque[:, i]) > 0.02 * np.ptp(torque, axis=0).max() + 1e-9]
    found += [group(here, here.axes[i], f"gravity_torque_{here.tags[i]}") for i in loaded]
    found += [group(here, here.frames[i], f"gravity_torque_{here.tags[max(i, 1)]}") for i in range(n)]
    found += [group(here, here.frames[i + 1], f"q{here.tags[i]}") for i in moving]
    if not here.scanner_on_flange:
        found += [group(here, f"station{s.id}", "pose") for s in here.obs.cell.stations]
        found += [group(here, "target", "incidence")] if here.obs.rotation is not None else []
    return [g for g in found if g is not None]


def unit_of(part: DescribedPart) -> str:
    """rad of what turns, mm of what shifts."""
    return "rad" if part.place in ("joint", "orientation") or (part.place in ("frame", "station") and part.component >= 3) else "mm"


def carried(groups: Sequence[EffectTerm]) -> list[EffectTerm]:
    """The groups that are kept for other recordings: all but the frame behind a joint by its angle. Over a part of a turn that is what
    errors of the geometry are as well; the arm so learnt is worse elsewhere (transfer.md).
    """
    return [g for g in groups if g.where[0].startswith(JOINTS) or not is_angle(g.depends_on)]


def common_pattern(here: Covariates, offset: Sequence[float], direction: Sequence[int], joints: Sequence[int]) -> EffectTerm:
    """One periodic function of the angles of several joints, each with its own offset (rad) and direction of rotation.

    Encoders of one make carry the same scale, which repeats its errors in every joint: joint i turns by
    direction_i f(direction_i q_i - offset_i) more than it reports.
    """
    orders = np.arange(1, OPTIONS.own_order + 1).astype(float)
    parts = []
    for i, o, d in zip(joints, offset, direction, strict=True):
        name = f"q{here.tags[i]}"
        # sin(k (d q - o)) = d cos(k o) sin(k q) - sin(k o) cos(k q), and cos(k (d q - o)) = cos(k o) cos(k q) + d sin(k o) sin(k q)
        sines = [_sum((d * np.cos(k * o) * d, sine(name, k)), (-np.sin(k * o) * d, cosine(name, k))) for k in orders]
        cosines = [_sum((np.cos(k * o) * d, cosine(name, k)), (d * np.sin(k * o) * d, sine(name, k))) for k in orders]
        parts.append(DescribedPart("joint", i, 0, (*sines, *cosines)))
    where = tuple(here.axes[i] for i in joints)
    hyper = {f"offset_{here.axes[i]}_rad": float(o) for i, o in zip(joints, offset, strict=True)}
    hyper |= {f"direction_{here.axes[i]}": float(d) for i, d in zip(joints, direction, strict=True)}
    sigma = pattern_sigma()
    units = ("rad",) * len(sigma)
    return EffectTerm.of_group(here, where, f"q{here.tags[joints[0]]}", parts, sigma, units, variant=COMMON_PATTERN, hyper=hyper)


def deviation(here: Covariates, joint: int) -> EffectTerm:
    """What a joint's own error differs from a common pattern by."""
    orders, name = np.arange(1, OPTIONS.own_order + 1).astype(float), f"q{here.tags[joint]}"
    part = DescribedPart("joint", joint, 0, (*(sine(name, k) for k in orders), *(cosine(name, k) for k in orders)))
    sigma = deviation_sigma()
    return EffectTerm.of_group(here, (here.axes[joint],), name, [part], sigma, ("rad",) * len(sigma), variant=DEVIATION)


def pattern_sigma() -> np.ndarray:
    """(2 K,) rad prior of the sines and cosines of a common pattern."""
    return 1e-3 * np.tile(order_weight(np.arange(1, OPTIONS.own_order + 1).astype(float)), 2)


def deviation_sigma() -> np.ndarray:
    """(2 K,) rad prior of what the sines and cosines of a joint's own error differ from a common pattern by."""
    orders = np.arange(1, OPTIONS.own_order + 1)
    return np.tile(np.where(orders <= 2, OPTIONS.slow_deviation_rad, OPTIONS.deviation_rad), 2)


def open_deviation_sigma() -> np.ndarray:
    """(2 K,) rad deviations while a pattern is sought: what geometry and gravity trade with (slow orders) must not speak against it."""
    slow = np.tile(np.arange(1, OPTIONS.own_order + 1) < OPTIONS.slow_order, 2)
    return np.where(slow, OPTIONS.open_deviation_rad, deviation_sigma())


def keys_of(here: Covariates, location: str) -> list[tuple[str, int, int]]:
    """(place, index, component) of what may move at a location."""
    if location in here.axes:
        return [("joint", here.axes.index(location), 0)]
    stations = here.obs.cell.stations
    if len(stations) == 1 and location == f"station{stations[0].id}":  # of several, slow drifts are in their places
        return [("station", 0, c) for c in range(6)]
    if location == "target":
        return [("orientation", 0, c) for c in range(3)] if here.obs.rotation is not None else []
    if location in here.frames:
        orientation = here.scanner_on_flange or here.obs.shows_target_orientation
        components = range(6) if location != "mount" or orientation else range(3)
        return [("frame", here.frames.index(location), c) for c in components]
    return []


def _functions(here: Covariates, location: str, covariate: str) -> tuple[Sequence[Column], np.ndarray]:
    """Columns by a covariate, and their relative prior sigma."""
    if covariate == "incidence":
        functions = of_second_degree(INCIDENCE)
        return functions, np.full(len(functions), 1e3 * OPTIONS.orientation_rad)
    values = np.asarray(here.value(covariate), dtype=float)
    if np.ptp(values) < 1e-9 * max(float(np.abs(values).max()), 1e-30):
        return [], np.zeros(0)
    if is_angle(covariate):
        joint = here.tags.index(covariate[1:])
        own, behind = location == here.axes[joint], location == here.frames[joint + 1]
        other = OPTIONS.bearing_order if behind else OPTIONS.other_order
        highest = OPTIONS.few_order if here.obs.n_poses < OPTIONS.many_poses else OPTIONS.own_order if own else other
        orders = np.arange(1, highest + 1).astype(float)
        weight = order_weight(orders) if own else 1 / (1 + (orders / 3) ** 2)
        return [sine(covariate, k) for k in orders] + [cosine(covariate, k) for k in orders], np.tile(weight, 2)
    if covariate == "pose":
        low, high = float(values.min()), float(values.max())
        orders = np.arange(1, OPTIONS.clock_functions + 1)
        return [of(covariate, "cosine", low, high, float(k)) for k in orders], OPTIONS.drift_mm / np.sqrt(orders)
    ends = from_degrees(OPTIONS.movement_deg)
    return [of(covariate, "clip", end, factor=1 / end) for end in ends], np.full(len(ends), OPTIONS.movement_size)


def _by_gravity(here: Covariates, location: str, covariate: str, keys: list[tuple[str, int, int]]) -> EffectTerm | None:
    """A joint by the torque about it, a link, base or mount by the moment of the weight behind it."""
    place, index, _ = keys[0]
    if place == "joint":
        own = f"gravity_torque_{here.tags[index]}"
        parts = [DescribedPart("joint", index, 0, (linear(own),))]
        return EffectTerm.of_group(
            here, (location,), covariate, parts, np.array([OPTIONS.compliance_rad_per_Nm]), (GIVES_WAY,), clamped=(own,)
        )
    if place != "frame" or len(keys) < 6:
        return None
    names = [f"gravity_moment_{here.frame_tags[index]}_{axis}" for axis in "xyz"]
    size = max(float(np.abs(here.gravity_moment(index)).max()), 1e-12)
    used = [c for c in range(3) if np.abs(here.value(names[c])).max() > 1e-6 * size]
    if not used:  # nothing with a mass is behind it
        return None
    parts = []
    for j, c in enumerate(used):
        columns = tuple(linear(names[c]) if i == j else () for i in range(len(used)))
        parts.append(DescribedPart("frame", index, 3 + c, columns))
    sigma = np.full(len(used), OPTIONS.tilt_rad_per_Nm)
    clamped = tuple(names[c] for c in used)
    return EffectTerm.of_group(here, (location,), covariate, parts, sigma, (GIVES_WAY,) * len(used), clamped=clamped)


def _grown(
    here: Covariates, location: str, covariate: str, keys: list[tuple[str, int, int]], columns: Sequence[Column], weight: np.ndarray
) -> EffectTerm:
    """Every component multiplied by every function, component by component; rotations a thousandth of the translations in size."""
    f, zero = len(columns), ()
    parts, sigma, units = list[DescribedPart](), [], list[str]()
    for j, (place, index, component) in enumerate(keys):
        own = [zero] * (j * f) + list(columns) + [zero] * ((len(keys) - 1 - j) * f)
        parts.append(DescribedPart(place, index, component, tuple(own)))
        unit = unit_of(parts[-1])
        sigma.append(weight * (1e-3 if unit == "rad" else 1.0))
        units += [unit] * f
    return EffectTerm.of_group(here, (location,), covariate, parts, np.concatenate(sigma), tuple(units))


def _sum(*weighted: tuple[float, Column]) -> Column:
    """Sum of columns, each times its factor."""
    return tuple(Product(float(factor) * p.factor, p.functions) for factor, column in weighted for p in column)
