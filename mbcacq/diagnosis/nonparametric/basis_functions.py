"""Basis functions that an unmodelled effect may follow: few coefficients before many, each shape one of functions of one covariate, with
prior weights that fall where a function is finer. All are written down, so that what is found can be kept.

They act at locations of the cell, whose components stand in axes in which neighbours can be told apart: those of a link in the frame of its
own joint, without the rotation about that joint, which is the joint's. A single component that is a rotation about the next joint as well
is left to that joint.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import ROUNDING
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import AXIS, TILT, Covariates
from mbcacq.effects.described import Evaluation
from mbcacq.effects.functions import SIGHT, ZERO, Column, DescribedPart, Product, cosine, linear, of, scaled, sine, standardized, times
from mbcacq.effects.learnt_range import is_angle
from mbcacq.effects.unmodelled import OPTIONS as UNMODELLED
from mbcacq.estimation.terms import PER_POSE


@dataclass(frozen=True)
class Location:
    """Where an unmodelled effect can act.

    Attributes
    ----------
    name : str
        Name as in the contract.
    keys : tuple[tuple[str, int, int], ...]
        (place, index, component) of its unit columns.
    mix : ndarray
        (c, len(keys)), components as combinations of them.
    variants : tuple[tuple[int, ...], ...]
        Components that may move together, each a tuple of rows of mix.
    frame : int
        The frame whose gravity moment acts here.
    joint : int
        Index of the joint there, or before it.
    """

    name: str
    keys: tuple[tuple[str, int, int], ...]
    mix: np.ndarray
    variants: tuple[tuple[int, ...], ...]
    frame: int = 0
    joint: int = 0

    @property
    def per_pose(self) -> bool:
        """Whether it moves a pose as a whole, by functions of the pose; else single centres, by functions of the centre."""
        return self.keys[0][0] in PER_POSE

    def described(self, rows: Sequence[int], columns: Sequence[Column]) -> list[DescribedPart]:
        """Some components by functions of the pose, or of the centre, component by component."""
        moved = zip(self.keys, self.mix[list(rows)].T, strict=True)
        return [DescribedPart(*k, tuple(scaled(f, float(m)) if m else ZERO for m in mix for f in columns)) for k, mix in moved if any(mix)]


def components(place: str, index: int = 0, count: int = 6) -> tuple[tuple[str, int, int], ...]:
    return tuple((place, index, c) for c in range(count))


def scanner_location() -> Location:
    """The measured point, in the frame of the instrument."""
    return Location("scanner", components("point", count=3), np.eye(3), ((0,), (1,), (2,), (0, 1), (0, 1, 2)))


def locations_of_arm(s: Context) -> list[Location]:
    """Joints, links, base and mount."""
    n = s.n
    out = [Location(s.axes[i], components("joint", i, 1), np.eye(1), ((0,),), i, i) for i in range(n)]
    chain = s.state.chain
    free = np.linalg.inv(chain.link_transforms(-chain.theta[None] * chain.sign)[:, :, :3, :3])[0]
    shifts, turns = ((0,), (1,), (2,), (0, 1, 2)), ((3,), (4,), (3, 4))
    for i in range(1, n):
        across = free[i - 1]  # columns: axes of the frame of joint i, turned with it, in the frame behind link i
        mix = np.zeros((5, 6))
        mix[:3, :3] = across.T
        mix[3:, 3:] = across.T[:2]
        own = [rows for rows in turns if len(rows) > 1 or np.hypot(*mix[rows[0], 3:5]) > OPTIONS.varies]
        out.append(Location(s.frames[i], components("frame", i), mix, (*shifts, *own, (0, 1, 2, 3, 4)), i, i - 1))
    six = (*shifts, *turns, (3, 4, 5), tuple(range(6)))
    out.append(Location("base", components("frame", 0), np.eye(6), six, 0, 0))
    turned = s.scanner_on_flange or s.obs.rotation is not None
    whole = (np.eye(6), six) if turned else (np.eye(3), shifts)
    return [*out, Location("mount", components("frame", n, len(whole[0])), *whole, n, n - 1)]


XYZ = ("x", "y", "z")


@dataclass(frozen=True)
class Shape:
    """Basis functions of one covariate.

    Attributes
    ----------
    depends_on : str
        Name of the covariate.
    columns : tuple[Column, ...]
        K functions of the pose, or of the centre, centred and of unit size.
    values : ndarray
        The same at the poses (P, k), or centres (M, k).
    weight : ndarray
        (k,) relative prior sigma of each.
    at : str
        Name of the location, where several share their components.
    """

    depends_on: str
    columns: tuple[Column, ...]
    values: np.ndarray
    weight: np.ndarray
    at: str = ""


@dataclass(frozen=True)
class Basis:
    """Makes shapes of functions that are written down, for the poses or the centres of a recording."""

    here: Context
    evaluation: Evaluation
    per_pose: bool

    @classmethod
    def of(cls, here: Context, per_pose: bool = True) -> Basis:
        return cls(here, Evaluation(here), per_pose)

    def values(self, name: str) -> np.ndarray:
        """(P,) or (M,) values of a covariate."""
        return self.evaluation.value(name) if self.per_pose else self.evaluation.at_centres(name)

    def shapes(self, name: str, columns: Sequence[Column], each: int | None = None, falling: bool = False, at: str = "") -> list[Shape]:
        """Centred functions of unit size, each a shape of its own (``each``) or all one shape, without those that do not vary."""
        F = self.evaluation(columns, self.per_pose)
        mean = F.mean(axis=0)
        centred = F - mean
        spread = np.sqrt(np.mean(centred**2, axis=0))
        varies = np.isfinite(spread) & (spread > 1e-9 * np.maximum(np.abs(F).max(axis=0, initial=0.0), 1e-30))
        out = []
        for j in range(0, len(columns), each or len(columns)):
            own = np.flatnonzero(varies[j : j + (each or len(columns))]) + j
            weight = 1.0 / (1.0 + 0.5 * np.arange(len(own))) if falling else np.ones(len(own))
            unit = tuple(standardized(columns[i], float(mean[i]), float(spread[i])) for i in own.tolist())
            out += [Shape(name, unit, centred[:, own] / spread[own], weight, at)] if len(own) else []
        return out

    def smooth(self, name: str, covariate: str) -> list[Shape]:
        """Smooth functions of a covariate: a straight line, alone and with few or more cosines over its range."""
        x = self.values(covariate)
        low, high = float(x.min()), float(x.min()) + max(float(np.ptp(x)), 1e-12)
        functions = [linear(covariate), *(of(covariate, "cosine", low, high, k) for k in range(1, OPTIONS.smooth))]
        return self.shapes(name, functions[:1]) + self.shapes(name, functions[:3]) + self.shapes(name, functions, falling=True)

    def thresholds(self, covariate: str) -> list[Shape]:
        """One coefficient each: a sigmoid about a value, its square, or the distance from the value to both sides."""
        x = self.values(covariate)
        span, columns = float(np.ptp(x)), list[Column]()
        for at in np.quantile(x, [0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9]):
            for width in (0.06 * span, 0.15 * span):
                sigmoid = of(covariate, "sigmoid", at, max(width, 1e-300))
                columns += [sigmoid, times(sigmoid, sigmoid)]
            columns.append(of(covariate, "distance", at))
        return self.shapes(covariate, columns, 1)

    def standard(self, covariate: str) -> Column:
        """A covariate, centred and of unit size."""
        x = self.values(covariate)
        return standardized(linear(covariate), float(x.mean()), max(float(x.std()), 1e-12))


def harmonics(covariate: str, first: int, last: int) -> list[Column]:
    """2 K columns: sine and cosine of each order of an angle."""
    return [column for k in range(first, last + 1) for column in (sine(covariate, k), cosine(covariate, k))]


def magnitude(covariate: str) -> Column:
    """|covariate|."""
    return of(covariate, "distance", 0.0)


# Functions of the pose ----------------------------------------------------------------------------------------------


def of_poses(basis: Basis) -> list[Shape]:
    """Joint angles, gravity, directions of rotation, time, temperatures, velocities, torques: the same at every location."""
    s = basis.here
    out, obs = list[Shape](), s.obs
    for i in turning(s):
        name = s.position(i)
        periodic = harmonics(name, 1, UNMODELLED.other_order)
        out += basis.shapes(name, periodic, 2) + basis.shapes(name, periodic[:4]) + basis.smooth(name, name)
    out += basis.shapes(f"gravity_torque_{s.tags[-1]}", [linear(f"gravity_direction_{s.tags[-1]}_{axis}") for axis in XYZ])
    if obs.direction is not None:
        out += [shape for i in range(s.n) for shape in directions(basis, i)]
    out += [shape for name in in_time(s) for shape in basis.smooth(name, name)] + history(basis)
    for name, values in (("qd", obs.velocity), ("tau", obs.torque)):
        if values is not None:
            out += [shape for tag in s.tags for shape in basis.shapes(f"{name}{tag}", [linear(f"{name}{tag}")])]
    return out + (basis.shapes("payload_kg", [linear("payload_kg")]) if obs.payload_kg is not None else [])


def at_location(basis: Basis, location: Location, angles: list[Shape]) -> list[Shape]:
    """More at a joint, a link, the base or the mount. angles: functions of one or two angles that are tried at joints."""
    s = basis.here
    out, is_joint = list[Shape](), len(location.mix) == 1
    for frame in {location.frame, max(location.frame - (not is_joint), 0)}:
        out += gravity_moments(basis, frame)
    if location.joint in turning(s):
        name = s.position(location.joint)
        out += basis.shapes(name, harmonics(name, UNMODELLED.other_order + 1, UNMODELLED.few_order), 2)
    if not is_joint:
        near = [i for i in turning(s) if abs(i - location.joint) <= OPTIONS.near_joints]
        out += pairs(basis, near, 1)
    if is_joint:
        torque = s.gravity_torque[:, location.joint]
        loaded = np.ptp(torque) > OPTIONS.varies * np.ptp(s.gravity_torque, axis=0).max() + 1e-9
        own = f"gravity_torque_{s.tags[location.joint]}"
        out += angles + (basis.thresholds(own) + stiffness_curves(basis, own) if loaded else [])
    return out


def stiffness_curves(basis: Basis, torque: str) -> list[Shape]:
    """Wind-up that stiffens or softens with the load, in the proportion of a power of it; and all of these together."""
    curves = [of(torque, "signed_power", p) for p in OPTIONS.stiffness_powers]
    return [
        *basis.shapes(torque, curves, 1),
        *(shape for curve in curves for shape in basis.shapes(torque, [linear(torque), curve])),
        *basis.shapes(torque, [linear(torque), *curves]),
    ]


def history(basis: Basis) -> list[Shape]:
    """What came before a pose: whether it is the first at a station, how far within the visit it is, how long ago the last pause was."""
    out = basis.shapes("visit", [of("visit", "decay", poses) for poses in OPTIONS.visits], 1)
    if clock(basis.here) != "time":
        return out
    return out + basis.shapes("pause", [of("since_pause", "decay", seconds) for seconds in OPTIONS.settles_s], 1)


def pairs(basis: Basis, joints: Iterable[int], orders: int) -> list[Shape]:
    """Functions of two angles: of their sum, of their difference, and products of up to so many periods a turn."""
    out = list[Shape]()
    for a, b in combinations([basis.here.position(i) for i in joints], 2):
        (sa, ca, *_), (sb, cb, *_) = first, second = harmonics(a, 1, orders), harmonics(b, 1, orders)
        same, opposite = (times(sa, cb), times(ca, sb)), (times(ca, cb), times(sa, sb))
        for sign in (1.0, -1.0):
            out += basis.shapes(a, [(*same[0], *scaled(same[1], sign)), (*opposite[0], *scaled(opposite[1], -sign))])
        out += basis.shapes(a, [times(x, y) for x in first for y in second])
    return out


def turning(s: Covariates) -> list[int]:
    """The joints whose angles vary."""
    return [i for i in range(s.n) if np.ptp(s.obs.q[:, i]) > OPTIONS.varies and is_angle(s.position(i))]


def directions(basis: Basis, i: int) -> list[Shape]:
    """The direction of rotation of joint i's last motion: alone, fading with the distance travelled, growing with the load."""
    tag = basis.here.tags[i]
    name, torque = f"direction_{tag}", f"gravity_torque_{tag}"
    if np.ptp(basis.values(name)) == 0:
        return []
    own, last = linear(name), linear(f"travel_direction_{tag}")
    fading = [own, *(times(last, of(f"travel_{tag}", "decay", reach)) for reach in OPTIONS.fading_reaches)]
    return [*basis.shapes(name, fading, 1), *basis.shapes(name, fading), *basis.shapes(name, [times(own, magnitude(torque))])]


def clock(s: Covariates) -> str:
    """Name of time, or of the order of the poses."""
    return "time" if s.obs.time_s is not None and np.ptp(s.obs.time_s) > 0 else "pose"


def in_time(s: Covariates) -> list[str]:
    """Names of time, or the order of the poses, and of every temperature that varies."""
    return [clock(s), *(name for name, T in s.obs.temperatures.items() if np.ptp(T) > 0.2)]


def gravity_torque(s: Covariates, frame: int) -> str:
    """Name of the covariate by which a frame's gravity moment is reported: a vertical first axis feels none, so the second does what tilts
    the base.
    """
    return f"gravity_torque_{s.tags[min(max(frame, 1), s.n - 1)]}"


def varying(name: str, components: np.ndarray, least: float) -> list[str]:
    """Names of the components (P, 3) of a covariate that vary by more than this over the poses."""
    return [f"{name}_{axis}" for axis, x in zip(XYZ, components.T, strict=True) if np.ptp(x) > least]


def gravity_moments(basis: Basis, frame: int) -> list[Shape]:
    """Components of the gravity moment of all that hangs behind a frame, about its origin: each by itself, and together."""
    moment, name = basis.here.gravity_moment(frame), gravity_torque(basis.here, frame)
    shown = varying(f"gravity_moment_{basis.here.frame_tags[frame]}", moment, np.sqrt(ROUNDING) * np.abs(moment).max())
    together = basis.shapes(name, [linear(x) for x in shown]) if len(shown) > 1 else []
    return [shape for x in shown for shape in basis.smooth(name, x)] + together


# Functions of the centre --------------------------------------------------------------------------------------------


def of_centres(basis: Basis) -> list[Shape]:
    """Functions of a centre's position: polynomials; in a scanner's field of view also the artefact's tilt, time and temperatures, gravity
    and periodic errors, far from an instrument its direction (errors along the line of sight).
    """
    s = basis.here
    out = polynomials(basis)
    if not s.scanner_on_flange:
        return out + basis.shapes("x", [linear(name) for name in SIGHT])
    if np.ptp(s.value(TILT)) > OPTIONS.varies:
        out += artefact_tilts(basis)
    for name in in_time(s):
        out += basis.smooth(name, name) + basis.shapes(name, [times(basis.standard(name), basis.standard(axis)) for axis in XYZ])
    out += basis.shapes(f"gravity_torque_{s.tags[-1]}", [linear(f"gravity_direction_{s.tags[-1]}_{axis}") for axis in XYZ])
    return out + periodic_component(basis, "x") + periodic_component(basis, "y")


def polynomials(basis: Basis) -> list[Shape]:
    """Scale, curvature and refraction, of coordinates that are centred and of unit size."""
    x, y, z = (basis.standard(axis) for axis in XYZ)
    xx, yy, zz = times(x, x), times(y, y), times(z, z)
    radial, astigmatic = (*xx, *yy), (*xx, *scaled(yy, -1.0))
    products = [times(*pair) for pair in ((x, y), (y, z), (z, x))]
    out = [shape for name in XYZ for shape in basis.smooth(name, name)]
    out += basis.shapes("x", [x, y, z]) + basis.shapes("x", [radial]) + basis.shapes("x", [radial, products[0], astigmatic])
    out += basis.shapes("x", [times(x, x, x), times(x, x, y), times(x, y, y), times(y, y, y)])
    out += basis.shapes("z", [products[2], products[1]])
    return out + basis.shapes("x", [x, y, z, xx, yy, zz, *products])


def periodic_component(basis: Basis, name: str) -> list[Shape]:
    """Sine and cosine of the position ``name`` (mm) along a field axis, by half periods down to the shortest one: fringes, lens tiles and
    pixel grids leave what no polynomial follows.
    """
    low, high = np.quantile(basis.values(name), [0.05, 0.95])
    width = 1.15 * float(high - low) / 0.9  # of the field that is used, and a little more; a few balls far outside do not count
    shortest = np.floor(width / OPTIONS.shortest_period_mm)
    if shortest < 2:
        return []
    orders = np.pi / width * np.arange(2, 2 * shortest + 1)
    return basis.shapes(name, [column for order in orders for column in wave(name, float(order), float(low))], 2)


def wave(name: str, order: float, at: float) -> tuple[Column, Column]:
    """sin(order (x - at)) and cos(order (x - at))."""
    c, s = float(np.cos(order * at)), float(np.sin(order * at))
    a, b = sine(name, order), cosine(name, order)
    return (*scaled(a, c), *scaled(b, -s)), (*scaled(b, c), *scaled(a, s))


def artefact_tilts(basis: Basis) -> list[Shape]:
    """The artefact's upward direction in the scanner's axes, its products, and how far it leans."""
    x, y, z = (linear(name) for name in AXIS)
    leaning: Column = (Product(1.0), *scaled(times(z, z), -1.0))
    side = of(AXIS[2], "sign")
    across = [times(side, one) for one in (x, y)]
    products: Iterable[Column] = [times(x, y), (*times(x, x), *scaled(times(y, y), -1.0))]
    whole = [leaning, *across, *products, times(leaning, x), times(leaning, y)]
    lean = [leaning, magnitude(AXIS[2])]
    return [shape for columns in ([leaning], lean, across, whole) for shape in basis.shapes(TILT, columns)]
