"""Scenarios: which effect is injected in which simulated cell, and how strong. Closed until the diagnosis has been made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.effects.catalogue import declaration, effects
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import AsJson

OUTSIDE = tuple("axis_wobble cable_drag floor_heave fringe_ripple link_bending loose_anchor short_memory spalled_raceway taut_hose".split())
NONE, TWO = "none", "two"
WEAKEST, STRONGEST = 0.05, 10.0  # by how much of the noise the effect raises chi2 per degree of freedom

# Columns that a recording may lack, and what is injected from outside the catalogue that needs them.
OUTSIDE_NEEDS: Mapping[str, tuple[str, ...]] = {"time_s": ("floor_heave",), "temperature": ("floor_heave",), "direction": ("short_memory",)}


def catalogued() -> tuple[str, ...]:
    """The effects of the catalogue that are injected, by the numbers that they declare."""
    numbers = {name: challenge.number or 0 for name in effects() if (challenge := declaration(name).challenge) is not None}
    return tuple(sorted((name for name, number in numbers.items() if number), key=lambda name: numbers[name]))


def needing(column: str) -> set[str]:
    """Effects that cannot be told from others without a column of the recording."""
    return {name for name in catalogued() if column in declaration(name).needs} | set(OUTSIDE_NEEDS[column])


@dataclass(frozen=True)
class Scenario(AsJson):
    """What a challenge conceals in a cell.

    Attributes
    ----------
    kind : str
        'none', 'two', or the name of the effect.
    seed : int
        Seed of the cell.
    names : tuple[str, ...]
        Names of the effects.
    effect_seed : int
        Seed of the place and shape of the effects.
    excess : float
        Amount by which the effects should raise chi2 per degree of freedom, once geometry has absorbed what it can.
    outliers : float
        Share of grossly wrong centres.
    missing : tuple[str, ...]
        Columns that are not recorded ('time_s', 'temperature', 'direction').
    """

    number: int
    kind: str
    seed: int
    names: tuple[str, ...]
    effect_seed: int
    excess: float
    outliers: float = 0.0
    missing: tuple[str, ...] = ()


def draw(seed: int, count: int, kinds: Sequence[str], outliers: float = 0.0, missing: Sequence[str] = ()) -> list[Scenario]:
    """``count`` scenarios, the kinds in turn (so that each occurs equally often), all else at random from ``seed``."""
    rng = np.random.default_rng([seed, 20])
    order = [kinds[i % len(kinds)] for i in range(count)]
    alone = [name for name in catalogued() if declaration(name).coupling is None]  # the others change what a second effect shows
    out = []
    for number, kind in enumerate(order):
        cell, effect = (int(v) for v in rng.integers(1, 2**31 - 1, 2))
        excess = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
        pair = tuple(str(v) for v in rng.choice(alone, 2, replace=False))
        names = {NONE: (), TWO: pair}.get(kind, (kind,))
        out.append(Scenario(number, kind, cell, names, effect, excess, outliers, missing=tuple(missing)))
    return out


def kinds(text: str, missing: Sequence[str] = ()) -> list[str]:
    """'catalogue', 'outside', 'none', 'two', 'mixed' or names, separated by commas; without the effects that need a missing column.

    Raises ConfigError for a name that is none of these.
    """
    known = catalogued()
    groups = {"catalogue": known, "outside": OUTSIDE, "mixed": (*known, *OUTSIDE, NONE)}
    out: list[str] = []
    for word in text.split(","):
        if word.strip() not in groups and word.strip() not in (*known, *OUTSIDE, NONE, TWO):
            raise ConfigError(
                f"there is no effect '{word.strip()}' to inject (known: {', '.join(groups)}, none, two, "
                f"{', '.join((*known, *OUTSIDE))}); correct --effects"
            )
        out += groups.get(word.strip(), (word.strip(),))
    impossible = {name for column in missing for name in needing(column)}
    left = [k for k in dict.fromkeys(out) if k not in impossible]
    if not left:
        raise ConfigError(f"without {' and '.join(missing)} none of the effects '{text}' can be identified; inject others")
    return left
