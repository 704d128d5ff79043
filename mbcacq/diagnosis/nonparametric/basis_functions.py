"""Basis functions that an unmodelled effect may follow: few coefficients before many, each shape one of functions of one covariate, with
prior weights that fall where a function is finer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric.locations import Location
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.search.candidate_scoring import ROUNDING
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import TILT
from mbcacq.effects.unmodelled import OPTIONS as UNMODELLED


@dataclass(frozen=True)
class Shape:
    """depends_on: name of the covariate. values: functions of the pose (P, k), or of the centre (M, k), centred and of unit size; weight:
    (k,) relative prior sigma of each. at: name of the location, where several share their components.
    """

    depends_on: str
    values: np.ndarray
    weight: np.ndarray
    at: str = ""


def shapes(name: str, functions: np.ndarray, each: int | None = None, falling: bool = False, at: str = "") -> list[Shape]:
    """Functions (P, f), centred and of unit size, as shapes of ``each`` of them, or as one; those that do not vary are left out."""
    F, varies = standardized(functions)
    out = []
    for j in range(0, F.shape[1], each or F.shape[1]):
        own = np.flatnonzero(varies[j : j + (each or F.shape[1])]) + j
        weight = 1.0 / (1.0 + 0.5 * np.arange(len(own))) if falling else np.ones(len(own))
        out += [Shape(name, F[:, own], weight, at)] if len(own) else []
    return out


def standardized(functions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Functions (P, f) centred and of unit size, and which of them vary (f,)."""
    F = np.asarray(functions, dtype=float).reshape(len(functions), -1)
    centred = F - F.mean(axis=0)
    spread = np.sqrt(np.mean(centred**2, axis=0))
    varies = np.isfinite(spread) & (spread > 1e-9 * np.maximum(np.abs(F).max(axis=0, initial=0.0), 1e-30))
    return centred / np.where(varies, spread, 1.0), varies


def smooth(name: str, x: np.ndarray) -> list[Shape]:
    """Smooth functions of a covariate x (P,): a straight line, alone and with few or more cosines over its range."""
    turned = np.pi * (x - np.min(x)) / max(float(np.ptp(x)), 1e-12)
    functions = np.c_[x, np.cos(turned[:, None] * np.arange(1, OPTIONS.smooth))]
    return shapes(name, x) + shapes(name, functions[:, :3]) + shapes(name, functions, falling=True)


def harmonics(q: np.ndarray, first: int, last: int) -> np.ndarray:
    """(P, 2 K) sine and cosine of each order of an angle q (P,)."""
    turned = q[:, None] * np.arange(first, last + 1)
    return np.stack([np.sin(turned), np.cos(turned)], axis=2).reshape(len(q), -1)


# Functions of the pose ----------------------------------------------------------------------------------------------


def of_poses(s: Context) -> list[Shape]:
    """Joint angles, gravity, directions of rotation, time, temperatures, velocities, torques: the same at every location."""
    out, obs = list[Shape](), s.obs
    for i in turning(s):
        periodic = harmonics(obs.q[:, i], 1, UNMODELLED.other_order)
        out += shapes(f"q{i + 1}", periodic, 2) + shapes(f"q{i + 1}", periodic[:, :4]) + smooth(f"q{i + 1}", obs.q[:, i])
    out += shapes(f"gravity_torque_{s.n}", s.flange_gravity)
    if obs.direction is not None:
        out += [shape for i in range(s.n) for shape in directions(s, i)]
    out += [shape for name, x in in_time(s) for shape in smooth(name, x)]
    for name, values in (("qd", obs.velocity), ("tau", obs.torque)):
        if values is not None:
            out += [shape for i, column in enumerate(values.T) for shape in shapes(f"{name}{i + 1}", np.nan_to_num(column))]
    return out + (shapes("payload_kg", obs.payload_kg) if obs.payload_kg is not None else [])


def at_location(s: Context, location: Location, angles: list[Shape]) -> list[Shape]:
    """More at a joint, a link, the base or the mount. angles: what sets in, at a joint, at some angle of any joint."""
    out, is_joint = list[Shape](), len(location.mix) == 1
    for frame in {location.frame, max(location.frame - (not is_joint), 0)}:
        out += gravity_moments(s, frame)
    if location.joint in turning(s):
        faster = harmonics(s.obs.q[:, location.joint], UNMODELLED.other_order + 1, UNMODELLED.few_order)
        out += shapes(f"q{location.joint + 1}", faster, 2)
    if is_joint:
        torque = s.gravity_torque[:, location.joint]
        loaded = np.ptp(torque) > OPTIONS.varies * np.ptp(s.gravity_torque, axis=0).max() + 1e-9
        out += angles + (thresholds(f"gravity_torque_{location.joint + 1}", torque) if loaded else [])
    return out


def turning(s: Context) -> list[int]:
    """The joints whose angles vary."""
    return [i for i in range(s.n) if np.ptp(s.obs.q[:, i]) > OPTIONS.varies]


def directions(s: Context, i: int) -> list[Shape]:
    """The direction of rotation of joint i's last motion: alone, fading with the distance travelled, growing with the load."""
    assert s.obs.direction is not None, "the recording has directions of rotation"
    if np.ptp(s.obs.direction[:, i]) == 0:
        return []
    name, own = f"direction_{i + 1}", s.obs.direction[:, i].astype(float)
    travel, direction = (values[:, i] for values in travelled(s))
    fading = np.stack([own, *(direction * np.exp(-travel / reach) for reach in OPTIONS.fading_reaches)], axis=1)
    return [*shapes(name, fading, 1), *shapes(name, fading), *shapes(name, own * np.abs(s.gravity_torque[:, i]))]


def travelled(s: Context) -> tuple[np.ndarray, np.ndarray]:
    """(P, n) rad of each joint's last motion before the pose, and (P, n) its direction of rotation; the first pose came from far away.

    Lost motion fades with it where grease, wind-up or a pre-sliding regime let it.
    """
    assert s.obs.direction is not None, "the recording has directions of rotation"
    listed = np.argsort(s.order, kind="stable")
    q, direction = s.obs.q[listed], s.obs.direction[listed].astype(float)
    travel = np.full(q.shape, np.inf)
    travel[1:] = np.abs(np.diff(q, axis=0))
    moved = travel > OPTIONS.varies * min(OPTIONS.fading_reaches)  # over less nothing fades
    last = np.maximum.accumulate(np.where(moved, np.arange(len(q))[:, None], 0), axis=0)
    out = np.empty(q.shape), np.empty(q.shape)
    out[0][listed], out[1][listed] = np.take_along_axis(travel, last, axis=0), np.take_along_axis(direction, last, axis=0)
    return out


def clock(s: Context) -> tuple[str, np.ndarray]:
    """Name and values (P,) of time, or of the order of the poses."""
    timed = s.obs.time_s is not None and np.ptp(s.obs.time_s) > 0
    return "time" if timed else "pose", np.asarray(s.time if timed else s.order, dtype=float)


def in_time(s: Context) -> list[tuple[str, np.ndarray]]:
    """(name, values (P,)) of time, or the order of the poses, and of every temperature that varies."""
    return [clock(s), *((name, T) for name, T in s.obs.temperatures.items() if np.ptp(T) > 0.2)]


def gravity_torque(s: Context, frame: int) -> str:
    """Name of the covariate by which a frame's gravity moment is reported: a vertical first axis feels none, so the second does what tilts
    the base.
    """
    return f"gravity_torque_{min(max(frame + 1, 2), s.n)}"


def gravity_moments(s: Context, frame: int) -> list[Shape]:
    """Components of the gravity moment of all that hangs behind a frame, about its origin: each by itself, and together."""
    moment, name = s.gravity_moment(frame), gravity_torque(s, frame)
    varying = [x for x in moment.T if np.ptp(x) ** 2 > ROUNDING * np.max(moment**2)]
    together = shapes(name, np.stack(varying, axis=1)) if len(varying) > 1 else []
    return [shape for x in varying for shape in smooth(name, x)] + together


def thresholds(name: str, x: np.ndarray) -> list[Shape]:
    """One coefficient each: a sigmoid about a value, its square, or the distance from the value to both sides."""
    span = float(np.ptp(x))
    away = x[:, None] - np.quantile(x, [0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9])
    narrow, wide = np.tanh(away / max(0.06 * span, 1e-300)), np.tanh(away / max(0.15 * span, 1e-300))
    return shapes(name, np.stack([narrow, narrow**2, wide, wide**2, np.abs(away)], axis=2).reshape(len(x), -1), 1)


# Functions of the centre --------------------------------------------------------------------------------------------


def of_centres(s: Context) -> list[Shape]:
    """Functions of a centre's position: polynomials; in a scanner's field of view also the artefact's tilt, time and temperatures, gravity
    and periodic errors, far from an instrument its direction (errors along the line of sight).
    """
    obs = s.obs
    x, y, z = ((v - v.mean()) / max(float(v.std()), 1e-12) for v in obs.xyz.T)
    out = polynomials(x, y, z)
    if not s.scanner_on_flange:
        return out + shapes("x", obs.xyz / np.maximum(np.linalg.norm(obs.xyz, axis=1, keepdims=True), 1e-9))
    if np.ptp(artefact_tilt(s)) > OPTIONS.varies:
        out += artefact_tilts(s)
    for name, values in in_time(s):
        here = standardized(values[obs.pose])[0]
        out += smooth(name, here[:, 0]) + shapes(name, here * np.stack([x, y, z], axis=1))
    gravity = s.prediction.T_base_scanner[:, :3, :3].transpose(0, 2, 1) @ obs.cell.robot.gravity
    out += shapes(f"gravity_torque_{s.n}", gravity[obs.pose])
    return out + periodic_component("x", obs.xyz[:, 0]) + periodic_component("y", obs.xyz[:, 1])


def polynomials(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> list[Shape]:
    """Scale, curvature and refraction; (M,) each, centred and of unit size."""
    out = [shape for name, v in zip("xyz", (x, y, z), strict=True) for shape in smooth(name, v)]
    linear, radial = np.stack([x, y, z], axis=1), x * x + y * y
    out += shapes("x", linear) + shapes("x", radial) + shapes("x", np.stack([radial, x * y, x * x - y * y], axis=1))
    out += shapes("x", np.stack([x**3, x * x * y, x * y * y, y**3], axis=1))
    out += shapes("z", np.stack([x * z, y * z], axis=1))
    return out + shapes("x", np.c_[linear, x * x, y * y, z * z, x * y, y * z, z * x])


def periodic_component(name: str, values: np.ndarray) -> list[Shape]:
    """Sine and cosine of the position ``values`` (M,) mm along a field axis, by half periods down to the shortest one: fringes, lens tiles
    and pixel grids leave what no polynomial follows.
    """
    low, high = np.quantile(values, [0.05, 0.95])
    width = 1.15 * float(high - low) / 0.9  # of the field that is used, and a little more; a few balls far outside do not count
    shortest = np.floor(width / OPTIONS.shortest_period_mm)
    if shortest < 2:
        return []
    phase = 2 * np.pi * (values - low)[:, None] / width * 0.5 * np.arange(2, 2 * shortest + 1)
    return shapes(name, np.stack([np.sin(phase), np.cos(phase)], axis=2).reshape(len(values), -1), 2)


def artefact_tilt(s: Context) -> np.ndarray:
    """(P,) rad between the scanner's axis and the artefact's z."""
    scanner, station = s.prediction.T_base_scanner[:, :3, 2], s.prediction.T_base_station[:, :3, 2]
    return np.arccos(np.clip(np.abs(np.sum(scanner * station, axis=1)), 0, 1))


def artefact_tilts(s: Context) -> list[Shape]:
    """The artefact's upward direction in the scanner's axes, its products, and how far it leans."""
    up = np.einsum("pji,pj->pi", s.prediction.T_base_scanner[:, :3, :3], s.prediction.T_base_station[:, :3, 2])[s.obs.pose]
    lean = np.abs(up[:, 2])
    leaning, across = 1 - lean**2, np.sign(up[:, 2:]) * up[:, :2]
    products = np.stack([up[:, 0] * up[:, 1], up[:, 0] ** 2 - up[:, 1] ** 2], axis=1)
    whole = np.c_[leaning, across, products, leaning[:, None] * up[:, :2]]
    return shapes(TILT, leaning) + shapes(TILT, np.c_[leaning, lean]) + shapes(TILT, across) + shapes(TILT, whole)
