"""Scenarios: which effect is injected in which simulated cell, and how strong. Closed until the diagnosis has been made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError

CATALOGUED = (
    "joint_compliance",
    "base_compliance",
    "mount_compliance",
    "gear_transmission_error",
    "backlash",
    "joint_scale",
    "wrist_coupling",
    "joint_step",
    "thermal_growth",
    "mount_shift",
    "scanner_scale",
    "scanner_distortion",
    "scanner_warmup",
    "ball_shift",
    "artefact_expansion",
    "station_drift",
    "lost_motion",
    "hysteresis",
    "gravity_compensator",
    "incidence_bias",
    "payload",
)
OUTSIDE = (
    "axis_wobble",
    "cable_drag",
    "floor_heave",
    "fringe_ripple",
    "link_bending",
    "loose_anchor",
    "short_memory",
    "spalled_raceway",
    "taut_hose",
)
NONE, TWO = "none", "two"
# What goes with an effect and is no false name: a wrong tool, a soft gearbox and a balancer show through elastic joints.
COMPANIONS: Mapping[str, tuple[str, ...]] = {
    "payload": ("joint_compliance",),
    "lost_motion": ("joint_compliance",),
    "gravity_compensator": ("joint_compliance",),
}
WEAKEST, STRONGEST = 0.05, 10.0  # by how much of the noise the effect raises chi2 per degree of freedom

# Columns that a recording may lack, and the effects that need them.
NEEDS: Mapping[str, tuple[str, ...]] = {
    "time_s": ("scanner_warmup", "station_drift", "thermal_growth", "floor_heave"),
    "temperature": ("thermal_growth", "floor_heave"),
    "direction": ("backlash", "hysteresis", "short_memory"),
}


@dataclass(frozen=True)
class Scenario:
    """kind: 'none', 'two', or the name of the effect. seed: of the cell. names: of the effects; effect_seed: of their place and shape.

    excess: by how much they should raise chi2 per degree of freedom, once geometry has absorbed what it can. outliers: share of
    grossly wrong centres. missing: columns that are not recorded ('time_s', 'temperature', 'direction').
    """

    number: int
    kind: str
    seed: int
    names: tuple[str, ...]
    effect_seed: int
    excess: float
    outliers: float = 0.0
    missing: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def draw(seed: int, count: int, kinds: Sequence[str], outliers: float = 0.0, missing: Sequence[str] = ()) -> list[Scenario]:
    """``count`` scenarios, the kinds in turn (so that each occurs equally often), all else at random from ``seed``."""
    rng = np.random.default_rng([seed, 20])
    order = [kinds[i % len(kinds)] for i in range(count)]
    out = []
    for number, kind in enumerate(order):
        cell, effect = (int(v) for v in rng.integers(1, 2**31 - 1, 2))
        excess = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
        pair = tuple(str(v) for v in rng.choice(CATALOGUED[:-1], 2, replace=False))
        names = {NONE: (), TWO: pair}.get(kind, (kind,))
        out.append(Scenario(number, kind, cell, names, effect, excess, outliers, tuple(missing)))
    return out


def kinds(text: str, missing: Sequence[str] = ()) -> list[str]:
    """'catalogue', 'outside', 'none', 'two', 'mixed' or names, separated by commas; without the effects that need a missing column.

    Raises ConfigError for a name that is none of these.
    """
    groups = {"catalogue": CATALOGUED, "outside": OUTSIDE, "mixed": (*CATALOGUED, *OUTSIDE, NONE)}
    out: list[str] = []
    for word in text.split(","):
        if word.strip() not in groups and word.strip() not in (*CATALOGUED, *OUTSIDE, NONE, TWO):
            raise ConfigError(
                f"there is no effect '{word.strip()}' to inject (known: {', '.join(groups)}, none, two, "
                f"{', '.join((*CATALOGUED, *OUTSIDE))}); correct --effects"
            )
        out += groups.get(word.strip(), (word.strip(),))
    impossible = {name for column in missing for name in NEEDS[column]}
    left = [k for k in dict.fromkeys(out) if k not in impossible]
    if not left:
        raise ConfigError(f"without {' and '.join(missing)} none of the effects '{text}' can be identified; inject others")
    return left
