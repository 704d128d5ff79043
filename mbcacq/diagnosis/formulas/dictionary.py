"""The terms of which formulas are made: functions of one covariate, and products of functions of two.

Every term is written down as columns of ``mbcacq.effects.functions``, so that a formula can be kept and evaluated at any other pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from itertools import combinations, product

import numpy as np

from mbcacq.diagnosis.nonparametric.basis_functions import Location
from mbcacq.diagnosis.options import OPTIONS as DIAGNOSIS
from mbcacq.effects import functions
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import LEAN
from mbcacq.effects.effect import Missing
from mbcacq.effects.functions import Column, Product, cosine, linear, of, sine
from mbcacq.effects.learnt_range import is_angle
from mbcacq.effects.unmodelled import OPTIONS as UNMODELLED

# Dictionary of formulas and effort of their search; ``benchmarks/formulas.md`` measures all of it together.
LEAST_RANGE = 0.02  # of a covariate, in its unit (rad, s, K, N m, mm): one that varies less is a constant with noise
PRODUCT_ORDERS = 2  # periods a turn in a product with something else
TIME_CONSTANTS = (0.08, 0.2, 0.5)  # time constants, in durations of the recording
MOST_TERMS = 3  # of a formula
PROPOSED = 3  # formulas that are reported
SCATTERS = 2.0  # standard deviations of the difference of squares, up to which a formula predicts as well as the smooth model
MOST_SEARCHES = 0.5  # share of the searches without a part of the data, more than which must find a formula again


HOUR = 3600.0  # s
FIELD = "xyz"


@dataclass(frozen=True)
class DictionaryEntry:
    """A group of columns that belong together, such as the sine and cosine of one order.

    shape: what it is a function of, whatever the phase, e.g. ``q4*q6`` or ``2q5``. columns: one for each coefficient, by its text.
    """

    shape: str
    columns: Mapping[str, Column]

    @property
    def covariates(self) -> tuple[str, ...]:
        """Names of the covariates, in order of appearance."""
        return tuple(dict.fromkeys(f.covariate for column in self.columns.values() for p in column for f in p.functions))

    @property
    def is_wave(self) -> bool:
        """Whether its order is one of a grid."""
        return self.shape.startswith("wave")


def entries(context: Context, location: Location) -> list[DictionaryEntry]:
    """The terms of a location: of the arm, functions of the pose; of the scanned point, functions of the centre in the field of view."""
    straight = varying(context, [context.position(i) for i in range(context.n)])
    angles = [name for e in straight for name in e.covariates]
    periodic = [harmonic(name, order) for name in angles for order in range(1, PRODUCT_ORDERS + 1)]
    if location.keys[0][0] == "point":
        field = varying(context, FIELD)
        measured = [*field, *slow(context), *varying(context, LEAN)]
        plain = [wave(e.shape, float(k)) for e in field[:2] for k in wave_orders(context, e.shape)]
        pairs = [*product(field, [*periodic, *(power(e, 2) for e in field)])]
    else:
        of_joints = [f"{kind}{tag}" for kind in ("direction_", "qd", "tau", "gravity_torque_") for tag in context.tags]
        of_frame = [f"{kind}_{a}" for kind in (f"gravity_moment_{context.frame_tags[location.frame]}", "payload_force") for a in FIELD]
        measured = [*slow(context), *varying(context, [*of_joints, "payload_kg", *of_frame])]
        highest = dict.fromkeys(angles, UNMODELLED.other_order) | {context.position(location.joint): UNMODELLED.few_order}
        plain = [*straight, *fading(context), *(harmonic(name, k) for name in angles for k in range(1, highest[name] + 1))]
        pairs = [*combinations(periodic, 2), *product(periodic, measured)]
    pairs = [pair for pair in (*pairs, *combinations(measured, 2)) if pair[0].covariates != pair[1].covariates]
    whole = [*plain, *powers(context, measured), *(times(*sorted(pair, key=lambda e: e.shape)) for pair in pairs)]
    of_several = (e for e in whole if len(e.columns) > 1 and not e.is_wave)
    return [*whole, *(DictionaryEntry(e.shape, {text: column}) for e in of_several for text, column in e.columns.items())]


def varying(context: Context, names: Iterable[str]) -> list[DictionaryEntry]:
    """Those covariates of a recording that vary, as linear functions: time in hours, temperatures relative to the first pose."""
    out = []
    for name in names:
        try:
            values = np.asarray(context.value(name), dtype=float)
        except Missing:
            continue
        columns = {name: linear(name)}
        if name == "time":
            columns = {"time[h]": linear(name, 1 / HOUR)}
        elif name in context.obs.temperatures:
            first = float(np.round(values[np.argmin(context.order)], 2))
            columns = {f"({name} - {first:g})": (*linear(name), Product(-first))}
        if np.ptp(values) > LEAST_RANGE:
            out.append(DictionaryEntry(f"linear {name}" if is_angle(name) else name, columns))
    return out


def slow(context: Context) -> list[DictionaryEntry]:
    """Time, or the order of the poses where no times were recorded, and temperatures."""
    return [*(varying(context, ["time"]) or varying(context, ["pose"])), *varying(context, context.obs.temperatures)]


def harmonic(name: str, order: int) -> DictionaryEntry:
    """Sine and cosine of an angle."""
    shape = name if order == 1 else f"{order}{name}"
    return DictionaryEntry(shape, {f"sin({shape})": sine(name, order), f"cos({shape})": cosine(name, order)})


def wave(name: str, order: float) -> DictionaryEntry:
    """Sine and cosine of a coordinate (mm) in the field of view; order: rad/mm."""
    angle = f"2 pi {name}/{2 * np.pi / order:.4g}"
    return DictionaryEntry(f"wave {name}", {f"sin({angle})": sine(name, order), f"cos({angle})": cosine(name, order)})


def wave_step(context: Context, name: str) -> float:
    """A quarter of a period over the field of view, as an order (rad/mm): waves that differ by less are much alike."""
    return float(np.pi / 2 / np.ptp(context.value(name)))


def wave_orders(context: Context, name: str) -> np.ndarray:
    """From one period over the field of view to the shortest one, by quarters of a period."""
    step = wave_step(context, name)
    return step * np.arange(4, 2 * np.pi / DIAGNOSIS.shortest_period_mm / step + 1)


def fading(context: Context) -> list[DictionaryEntry]:
    """Exponential functions of time, where it was recorded."""
    constants = [float(f"{share * context.time.max():.2g}") for share in TIME_CONSTANTS if varying(context, ["time"])]
    return [DictionaryEntry("fading time", {f"exp(-time/{c:g} s)": of("time", "decay", c)}) for c in constants]


def powers(context: Context, first: Iterable[DictionaryEntry]) -> list[DictionaryEntry]:
    """Linear functions, their squares and cubes; a quantity with both signs also has its magnitude and sign."""
    out = []
    for one in first:
        out += [one, power(one, 2), power(one, 3)]
        (name,), (text,) = one.covariates, one.columns
        if np.min(context.value(name)) < 0 < np.max(context.value(name)):
            sign = DictionaryEntry(f"sign {name}", {f"sign({text})": of(name, "sign")})
            out += [sign, DictionaryEntry(f"|{name}|", {f"|{text}|": column for column in times(sign, one).columns.values()})]
    return out


def power(one: DictionaryEntry, exponent: int) -> DictionaryEntry:
    """A linear function to a power."""
    columns = reduce(times, [one] * exponent).columns.values()
    return DictionaryEntry(f"{one.shape}^{exponent}", {f"{text}^{exponent}": of for text, of in zip(one.columns, columns, strict=True)})


def times(a: DictionaryEntry, b: DictionaryEntry) -> DictionaryEntry:
    """Every column of one times every column of the other."""
    columns = {f"{s} {t}": functions.times(c, d) for (s, c), (t, d) in product(a.columns.items(), b.columns.items())}
    return DictionaryEntry(f"{a.shape}*{b.shape}", columns)
