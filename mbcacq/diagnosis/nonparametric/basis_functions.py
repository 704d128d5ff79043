"""Basis functions that an unmodelled effect may follow: few coefficients before many, each a shape of one covariate.

All functions of all covariates stand in one table; a shape is a choice of its columns, with prior weights that fall where a
function is finer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq.diagnosis.nonparametric import joint_travel
from mbcacq.diagnosis.nonparametric.artefact_tilt import artefact_tilt
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.context import Context


@dataclass(frozen=True)
class BasisFunction:
    """depends_on: name of the covariate. index: columns of the table; weight: relative prior sigma of each."""

    depends_on: str
    index: np.ndarray
    weight: np.ndarray


@dataclass
class BasisTable:
    """columns: functions of the pose (P,) or of the centre (M,); shapes: choices among them."""

    columns: list[np.ndarray] = field(default_factory=list)
    shapes: list[BasisFunction] = field(default_factory=list)

    def add(self, functions) -> np.ndarray:
        """Indices of new columns (P, f), centred and of unit size; those that do not vary are left out."""
        each = self.add_each(functions)
        return np.concatenate(each) if each else np.zeros(0, int)

    def add_each(self, functions) -> list[np.ndarray]:
        """The same, column by column: the index of each, none of one that does not vary."""
        F = np.asarray(functions, dtype=float)
        F = F[:, None] if F.ndim == 1 else F
        centred = F - F.mean(axis=0)
        spread = np.sqrt(np.mean(centred**2, axis=0))
        varies = np.isfinite(spread) & (spread > 1e-9 * np.maximum(np.abs(F).max(axis=0, initial=0.0), 1e-30))
        start = len(self.columns)
        self.columns.extend((centred[:, varies] / spread[varies]).T)
        return np.split(start + np.arange(varies.sum()), np.cumsum(varies)[:-1]) if len(varies) else []

    def shape(self, name: str, index: np.ndarray, falling: bool = False) -> None:
        if len(index):
            weight = 1.0 / (1.0 + 0.5 * np.arange(len(index))) if falling else np.ones(len(index))
            self.shapes.append(BasisFunction(name, np.asarray(index), weight))

    @property
    def values(self) -> np.ndarray:
        return np.stack(self.columns, axis=1)


def cosines(x: np.ndarray, count: int) -> np.ndarray:
    """(P, count) cosines over the range of x (P,): smooth, and bounded where there are no data."""
    low, span = float(np.min(x)), max(float(np.ptp(x)), 1e-12)
    return np.cos(np.pi * ((np.asarray(x, dtype=float) - low) / span)[:, None] * np.arange(1, count + 1))


def of_poses(s: Context) -> BasisTable:
    """Joint angles, gravity, directions of rotation, time, temperatures, velocities, torques: the same at every location."""
    table, obs = BasisTable(), s.obs
    for i in range(s.n):
        if np.ptp(obs.q[:, i]) > 0.02:
            joint_angle(table, f"q{i + 1}", obs.q[:, i])
    table.shape(f"gravity_torque_{s.n}", table.add(s.flange_gravity))
    if obs.direction is not None:
        for i in range(s.n):
            if np.ptp(obs.direction[:, i]) > 0:
                directions(table, s, i)
    for name, index in in_time(table, s):
        table.shape(name, index[:1])
        table.shape(name, index, falling=True)
    for name, values in (("qd", obs.velocity), ("tau", obs.torque)):
        if values is not None:
            each_joint(table, name, values)
    if obs.payload_kg is not None:
        table.shape("payload_kg", table.add(obs.payload_kg))
    return table


def each_joint(table: BasisTable, name: str, values: np.ndarray) -> None:
    """Velocities or torques (P, n), each joint's by itself."""
    for i, column in enumerate(values.T):
        table.shape(f"{name}{i + 1}", table.add(np.nan_to_num(column)))


def joint_angle(table: BasisTable, name: str, q: np.ndarray) -> None:
    """Harmonics and smooth functions of a joint's angle q (P,)."""
    periodic = add_harmonics(table, q, np.arange(1, OPTIONS.harmonics + 1))
    for index in periodic:
        table.shape(name, index)
    table.shape(name, np.concatenate(periodic[:2]))
    smooth = table.add(cosines(q, OPTIONS.cosines))
    table.shape(name, smooth[:2])
    table.shape(name, smooth, falling=True)


def directions(table: BasisTable, s: Context, i: int) -> None:
    """The direction of rotation of joint i's last motion: alone, fading with the distance travelled, growing with the load."""
    fading = table.add(joint_travel.functions(s, i))
    for j in range(len(fading)):
        table.shape(f"direction_{i + 1}", fading[j : j + 1])
    table.shape(f"direction_{i + 1}", fading)
    loaded = table.add(joint_travel.directions(s)[:, i] * np.abs(s.gravity_torque[:, i]))
    table.shape(f"direction_{i + 1}", loaded)


def in_time(table: BasisTable, s: Context) -> list[tuple[str, np.ndarray]]:
    """(name, columns: straight line first) of time, or the order of the poses, and every temperature."""
    timed = s.obs.time_s is not None and np.ptp(s.obs.time_s) > 0
    clock = np.asarray(s.time if timed else s.order, dtype=float)
    out = [("time" if timed else "pose", np.concatenate([table.add(clock), table.add(cosines(clock, OPTIONS.cosines))]))]
    for name, T in s.obs.temperatures.items():
        if np.ptp(T) > 0.2:
            x = (T - T.mean()) / T.std()
            out.append((name, table.add(np.stack([x, x * x], axis=1))))
    return out


def gravity_moments(s: Context, frame: int) -> BasisTable:
    """Components of the gravity moment of all that hangs behind a frame, about its origin: linear, and nonlinear."""
    table, moment = BasisTable(), s.gravity_moment(frame)
    size, linear = np.abs(moment).max(), list[np.ndarray]()
    name = f"gravity_torque_{min(max(frame + 1, 2), s.n)}"  # a vertical first axis feels none: the second does what tilts the base
    for x in moment.T:
        if np.ptp(x) > 0.005 * size:
            first = table.add(x)
            linear.append(first)
            nonlinear = np.concatenate([first, table.add(cosines(x, 4))])
            table.shape(name, first)
            table.shape(name, nonlinear[:3])
            table.shape(name, nonlinear, falling=True)
    if len(linear) > 1:
        table.shape(name, np.concatenate(linear))
    return table


def higher_harmonics(q: np.ndarray, name: str) -> BasisTable:
    """More periodic functions of an angle: of the joint at, or before, the location."""
    table = BasisTable()
    for index in add_harmonics(table, q, np.arange(OPTIONS.harmonics + 1, OPTIONS.own_harmonics + 1)):
        table.shape(name, index)
    return table


def add_harmonics(table: BasisTable, q: np.ndarray, orders: np.ndarray) -> list[np.ndarray]:
    """Sine and cosine of each order of an angle q (P,), the indices of those of one order together."""
    turned = q[:, None] * orders
    each = table.add_each(np.stack([np.sin(turned), np.cos(turned)], axis=2).reshape(len(q), -1))
    return [np.concatenate(each[j : j + 2]) for j in range(0, len(each), 2)]


def narrow(q: np.ndarray, name: str) -> BasisTable:
    """Functions of a joint's own angle narrow enough for a bump."""
    table = BasisTable()
    table.shape(name, table.add(cosines(q, OPTIONS.narrow_cosines)))
    return table


def thresholds(x: np.ndarray, name: str) -> BasisTable:
    """One coefficient each: a sigmoid about a value, its square, or the distance from the value to both sides."""
    table, span = BasisTable(), float(np.ptp(x))
    middle = np.quantile(x, [0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9])
    away = x[:, None] - middle
    narrow, wide = np.tanh(away / max(0.06 * span, 1e-300)), np.tanh(away / max(0.15 * span, 1e-300))
    each = np.stack([narrow, narrow**2, wide, wide**2, np.abs(away)], axis=2)
    for index in table.add_each(each.reshape(len(x), -1)):
        table.shape(name, index)
    return table


def of_field(s: Context) -> BasisTable:
    """Functions of the centre: polynomials over the field of view, the artefact's tilt, time and temperatures."""
    table, obs = BasisTable(), s.obs
    x, y, z = ((v - v.mean()) / max(float(v.std()), 1e-12) for v in obs.xyz.T)
    linear = {name: table.add(v) for name, v in zip("xyz", (x, y, z), strict=True)}
    for name, v in zip("xyz", (x, y, z), strict=True):
        table.shape(name, np.concatenate([linear[name], table.add(np.stack([v**2, v**3], axis=1))]), falling=True)
    radial = table.add(x * x + y * y)
    table.shape("x", radial)
    table.shape("x", np.concatenate([radial, table.add(np.stack([x * y, x * x - y * y], axis=1))]))
    table.shape("x", table.add(np.stack([x**3, x * x * y, x * y * y, y**3], axis=1)))
    table.shape("z", table.add(np.stack([x * z, y * z], axis=1)))
    if np.ptp(artefact_tilt(s)) > 0.02:
        artefact_tilts(table, s)
    for name, index in in_time(per_pose := BasisTable(), s):
        values = [per_pose.columns[j][obs.pose] for j in index]
        here = table.add(np.stack(values, axis=1))
        table.shape(name, here[:1])
        table.shape(name, here, falling=True)
        table.shape(name, table.add(np.stack([values[0] * v for v in (x, y, z)], axis=1)))
    gravity = s.prediction.T_base_scanner[:, :3, :3].transpose(0, 2, 1) @ s.obs.cell.robot.gravity
    table.shape(f"gravity_torque_{s.n}", table.add(gravity[obs.pose]))
    return table


def of_volume(s: Context) -> BasisTable:
    """Functions of a target's position far from the instrument: its direction (errors along the line of sight) and polynomials (scale,
    refraction).
    """
    table, xyz = BasisTable(), s.obs.xyz
    table.shape("x", table.add(xyz / np.maximum(np.linalg.norm(xyz, axis=1, keepdims=True), 1e-9)))
    x, y, z = ((v - v.mean()) / float(v.std()) for v in xyz.T)
    linear = {name: table.add(v) for name, v in zip("xyz", (x, y, z), strict=True)}
    for name, v in zip("xyz", (x, y, z), strict=True):
        table.shape(name, linear[name])
        table.shape(name, np.concatenate([linear[name], table.add(v * v)]))
    all_linear = np.concatenate(list(linear.values()))
    table.shape("x", all_linear)
    table.shape("x", np.concatenate([all_linear, table.add(np.stack([x * x, y * y, z * z, x * y, y * z, z * x], axis=1))]))
    return table


def artefact_tilts(table: BasisTable, s: Context) -> None:
    """The artefact's upward direction in the scanner's axes, its products, and how far it leans."""
    up = np.einsum("pji,pj->pi", s.prediction.T_base_scanner[:, :3, :3], s.prediction.T_base_station[:, :3, 2])[s.obs.pose]
    lean = np.abs(up[:, 2])
    nonlinear = table.add(np.stack([1 - lean**2, lean], axis=1))
    table.shape("tilt", nonlinear[:1])
    table.shape("tilt", nonlinear)
    across = table.add(np.sign(up[:, 2:]) * up[:, :2])
    table.shape("tilt", across)
    strong = table.add((1 - lean**2)[:, None] * up[:, :2])
    table.shape("tilt", np.concatenate([nonlinear[:1], strong]))
    products = table.add(np.stack([up[:, 0] * up[:, 1], up[:, 0] ** 2 - up[:, 1] ** 2], axis=1))
    table.shape("tilt", np.concatenate([nonlinear[:1], across, products, strong]))
