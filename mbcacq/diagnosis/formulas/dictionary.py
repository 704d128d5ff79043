"""The terms of which formulas are made: functions of one covariate, and products of functions of two.

Every term is written down as columns of ``mbcacq.effects.functions``, so that a formula can be kept and evaluated at any other pose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from mbcacq.diagnosis.formulas.options import OPTIONS
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Missing
from mbcacq.effects.effect_term import is_angle
from mbcacq.effects.functions import Column, Function, Product

LEAST_ANGLE = 0.02  # rad of travel below which nothing is a function of an angle
LEAST_SHARE = 0.02  # of the largest gravity torque's range
LEAST_K = 0.2  # range of a temperature
HOUR = 3600.0
FIELD = "xyz"


@dataclass(frozen=True)
class DictionaryEntry:
    """A group of columns that belong together, such as the sine and cosine of one order.

    shape: what it is a function of, whatever the phase, e.g. ``q4*q6`` or ``2q5``. columns: one for each coefficient; texts: the same
    for people. log_prior: log of its prior probability among all terms of a location. wave: its order is one of a grid.
    """

    shape: str
    columns: tuple[Column, ...]
    texts: tuple[str, ...]
    log_prior: float = 0.0
    wave: bool = False

    @property
    def covariates(self) -> tuple[str, ...]:
        """Names of the covariates, in order of appearance."""
        return tuple(dict.fromkeys(f.covariate for column in self.columns for p in column for f in p.functions))

    @property
    def label(self) -> str:
        """Tells it apart from the other terms."""
        return f"{self.shape}[{'; '.join(self.texts)}]"


@dataclass(frozen=True)
class Factor:
    """One function of one covariate, as a column with its text; shape: as of a term."""

    shape: str
    covariate: str
    column: Column
    text: str


def of_pose(context: Context, joint: int, frame: int, located: str) -> list[DictionaryEntry]:
    """Terms that are one number a pose, for a location of the arm. joint, frame: index of the joint there, or before it, and of the frame
    whose gravity moment acts there. located: the covariate that the diagnosis found.
    """
    angles = [f"q{i + 1}" for i in range(context.n) if np.ptp(context.obs.q[:, i]) > LEAST_ANGLE]
    plain = [t for name in angles for t in _orders(name, OPTIONS.own_orders if name == f"q{joint + 1}" else OPTIONS.orders)]
    slow = [f for f in (*_clock(context), *_temperatures(context), *_recorded(context)) if _varies(context, f)]
    weights = [f for f in (*_torques(context), *_moments(frame)) if _varies(context, f)]
    plain += [_single(_power(name, 1)) for name in angles]
    plain += [_single(f) for first in (*slow, *weights) for f in _powers(first)]
    plain += _fading(context)
    periodic = [f for name in angles for order in range(1, OPTIONS.product_orders + 1) for f in _phases(name, order)]
    return _with_priors([*plain, *_products([*periodic, *slow, *weights])], located)


def of_centre(context: Context, located: str) -> list[DictionaryEntry]:
    """Terms that are one number a centre, for the scanner: polynomials over the field of view, waves, and products with what is one
    number a pose.
    """
    here = [name for c, name in enumerate(FIELD) if np.ptp(context.obs.xyz[:, c]) > 1e-6]
    linear = [_power(name, 1, 0.01) for name in here]
    plain = [_single(f) for first in linear for f in _powers(first)]
    plain += [_single(f) for first in (*_clock(context), *_temperatures(context)) if _varies(context, first) for f in _powers(first)]
    for name in here[:2]:
        span = float(np.ptp(context.value(name)))
        plain += [_wave(name, np.pi * k / span) for k in 0.5 * np.arange(2, OPTIONS.waves + 1)]
    leaning = [_power(name, 1) for name in ("lean_x", "lean_y", "lean_z")]
    slow = [f for f in (*_clock(context), *_temperatures(context), *leaning) if _varies(context, f)]
    plain += [_single(f) for f in leaning if f in slow]
    periodic = [f for i in range(context.n) for f in _phases(f"q{i + 1}", 1) if np.ptp(context.obs.q[:, i]) > LEAST_ANGLE]
    products = _products(linear) + [_multiplied(a, b) for a in linear for b in (*slow, *periodic)]
    products += [_multiplied(a, b) for a in linear for b in (_power(name, 2, 0.01) for name in here) if a.covariate != b.covariate]
    return _with_priors([*plain, *products, *_products(leaning)], located)


def with_order(term: DictionaryEntry, order: float) -> DictionaryEntry:
    """A wave with another order (rad/mm)."""
    return replace(_wave(term.covariates[0], order), log_prior=term.log_prior)


def order_of(term: DictionaryEntry) -> float:
    """Order of a wave, rad/mm."""
    return term.columns[0][0].functions[0].numbers[0]


# Factors --------------------------------------------------------------------------------------------------------------


def _phases(name: str, order: int) -> list[Factor]:
    shape = name if order == 1 else f"{order}{name}"
    return [Factor(shape, name, (Product(1.0, (Function(name, kind, (float(order),)),)),), f"{kind}({shape})") for kind in ("sin", "cos")]


def _power(name: str, power: int, scale: float = 1.0) -> Factor:
    text = {1: name, 2: f"{name}^2", 3: f"{name}^3"}[power]
    shape = f"linear {name}" if is_angle(name) else text
    return Factor(shape, name, (Product(scale**power, (Function(name, "power", (float(power),)),)),), _scaled_text(text, scale, power))


def _scaled_text(text: str, scale: float, power: int) -> str:
    return text if scale == 1.0 else f"{text}/{1 / scale**power:.4g}"


def _clock(context: Context) -> list[Factor]:
    """Time in hours, or the order of the poses where no times were recorded."""
    if context.obs.time_s is None or np.ptp(context.obs.time_s) == 0:
        return [_power("pose", 1)]
    return [Factor("time", "time", (Product(1 / HOUR, (Function("time"),)),), "time[h]")]


def _temperatures(context: Context) -> list[Factor]:
    """Temperatures relative to the first pose."""
    out = []
    for name, values in context.obs.temperatures.items():
        if np.ptp(values) > LEAST_K:
            first = float(np.round(np.asarray(values)[np.argmin(context.order)], 2))
            out.append(Factor(name, name, (Product(1.0, (Function(name),)), Product(-first)), f"({name} - {first:g})"))
    return out


def _recorded(context: Context) -> list[Factor]:
    names = [f"{kind}{i + 1}" for kind in ("direction_", "qd", "tau") for i in range(context.n)]
    return [_power(name, 1) for name in (*names, *(() if context.obs.payload_kg is None else ("payload_kg",)))]


def _torques(context: Context) -> list[Factor]:
    """Gravity torques of joints that carry something."""
    torque = context.gravity_torque
    loaded = np.ptp(torque, axis=0) > LEAST_SHARE * np.ptp(torque, axis=0).max() + 1e-9
    return [_power(f"gravity_torque_{i + 1}", 1) for i in np.flatnonzero(loaded)]


def _moments(frame: int) -> list[Factor]:
    return [_power(f"gravity_moment_{frame}_{axis}", 1) for axis in FIELD] + [_power(f"payload_force_{axis}", 1) for axis in FIELD]


def _varies(context: Context, factor: Factor) -> bool:
    try:
        values = np.asarray(context.value(factor.covariate), dtype=float)
    except Missing:
        return False
    return bool(np.ptp(values) > 1e-9 * max(float(np.abs(values).max()), 1e-30))


# Terms ----------------------------------------------------------------------------------------------------------------


def _single(factor: Factor) -> DictionaryEntry:
    return DictionaryEntry(factor.shape, (factor.column,), (factor.text,))


def _orders(name: str, highest: int) -> list[DictionaryEntry]:
    """Sine and cosine of each order together, and each by itself."""
    out = []
    for order in range(1, highest + 1):
        sine, cosine = _phases(name, order)
        out += [DictionaryEntry(sine.shape, (sine.column, cosine.column), (sine.text, cosine.text)), _single(sine), _single(cosine)]
    return out


def _powers(factor: Factor) -> list[Factor]:
    """The factor, its square and cube, and its magnitude."""
    if factor.covariate.startswith("direction_"):
        return [factor]
    out = [factor]
    for power in (2, 3):
        squared = _times(out[-1], factor)
        out.append(replace(squared, shape=f"{factor.shape}^{power}", text=f"{factor.text}^{power}"))
    if factor.covariate.startswith(("gravity", "payload_force", "lean")):
        sign = Factor("", factor.covariate, (Product(1.0, (Function(factor.covariate, "sign", ()),)),), "")
        out.append(replace(_times(sign, factor), shape=f"|{factor.shape}|", text=f"|{factor.text}|"))
        out.append(replace(sign, shape=f"sign {factor.shape}", text=f"sign({factor.text})"))
    return out


def _fading(context: Context) -> list[DictionaryEntry]:
    try:
        duration = float(context.time.max())
    except Missing:
        return []
    out = []
    for share in OPTIONS.fading:
        constant = float(f"{share * duration:.2g}")
        column = (Product(1.0, (Function("time", "decay", (constant,)),)),)
        out.append(DictionaryEntry("fading time", (column,), (f"exp(-time/{constant:g} s)",)))
    return out


def _wave(name: str, order: float) -> DictionaryEntry:
    columns = tuple((Product(1.0, (Function(name, kind, (float(order),)),)),) for kind in ("sin", "cos"))
    period = 2 * np.pi / order
    return DictionaryEntry(f"wave {name}", columns, tuple(f"{kind}(2 pi {name}/{period:.4g})" for kind in ("sin", "cos")), wave=True)


def _times(a: Factor, b: Factor) -> Factor:
    column = tuple(Product(p.factor * q.factor, (*p.functions, *q.functions)) for p, q in product(a.column, b.column))
    return Factor(f"{a.shape}*{b.shape}", a.covariate, column, f"{a.text} {b.text}")


def _multiplied(a: Factor, b: Factor) -> DictionaryEntry:
    first, second = sorted((a, b), key=lambda f: f.shape)
    return _single(_times(first, second))


def _products(factors: Sequence[Factor]) -> list[DictionaryEntry]:
    """Products of two factors of different covariates; of two angles also with free phases."""
    out = [_multiplied(a, b) for a, b in combinations(factors, 2) if a.covariate != b.covariate]
    free: dict[str, list[DictionaryEntry]] = {}
    for term in out:
        free.setdefault(term.shape, []).append(term)
    return out + [_joined(terms) for terms in free.values() if len(terms) > 1]


def _joined(terms: Sequence[DictionaryEntry]) -> DictionaryEntry:
    return DictionaryEntry(terms[0].shape, tuple(c for t in terms for c in t.columns), tuple(x for t in terms for x in t.texts))


def _with_priors(terms: Sequence[DictionaryEntry], located: str) -> list[DictionaryEntry]:
    """Functions of one covariate and products each share their part of the prior alike; those with the located covariate get half of it."""
    weight = np.zeros(len(terms))
    classes: tuple[tuple[float, Callable[[DictionaryEntry], bool]], ...] = (
        (1 - OPTIONS.products, lambda t: "*" not in t.shape),
        (OPTIONS.products, lambda t: "*" in t.shape),
    )
    for share, belongs in classes:
        mine = np.array([belongs(t) for t in terms])
        found = mine & np.array([located in t.covariates for t in terms])
        weight += share * (1 - OPTIONS.located) * mine / max(mine.sum(), 1)
        weight += share * OPTIONS.located * (found if found.any() else mine) / max(found.sum() or mine.sum(), 1)
    logs = np.log(weight / weight.sum())
    return [replace(term, log_prior=float(log)) for term, log in zip(terms, logs, strict=True)]
