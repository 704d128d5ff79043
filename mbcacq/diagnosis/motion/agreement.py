"""What poses and motion state of the same thing: parameters that both found, and pairs of effects of which one of them names one."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtri

from mbcacq.diagnosis.findings import TOGETHER, NotSeparable
from mbcacq.diagnosis.motion.joint_sets import apart
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.model.json_text import Number
from mbcacq.quantities import split_unit

FARTHEST = 38.0  # standard deviations: beyond, the probability of a normal distribution is no floating point number


@dataclass(frozen=True)
class ParameterAgreement:
    """A parameter of an effect that was found in the poses and in the motion.

    Attributes
    ----------
    name, where, parameter
        The effect, its locations, and the parameter with its unit.
    poses, motion
        Both estimates.
    sigmas
        Their distance in combined standard deviations; several components have the distance of one that is as improbable as all together.
    agrees
        Whether that is less than three.
    """

    name: str
    where: tuple[str, ...]
    parameter: str
    poses: ParameterEstimate
    motion: ParameterEstimate
    sigmas: Number
    agrees: bool

    @property
    def label(self) -> str:
        """Effect, locations and parameter in words."""
        return f"{self.name} at {'+'.join(self.where)}, {split_unit(self.parameter)[0]}"

    def stated(self) -> tuple[str, str]:
        """What the poses and what the motion state, each with its expanded uncertainty."""
        _, unit, factor = split_unit(self.parameter)
        return self.poses.shown(unit, factor), self.motion.shown(unit, factor)

    def __str__(self) -> str:
        of_poses, of_motion = self.stated()
        verdict = "they agree" if self.agrees else "they contradict each other"
        return f"{self.label}: {of_poses} from the poses, {of_motion} from the motion: {verdict} ({self.sigmas:.1f} sigma)"


@dataclass(frozen=True)
class DecidedPair:
    """Effects that one diagnosis cannot tell apart, of which one is named. by: 'poses' or 'motion', where the other one names it by itself;
    'both', where the evidence of both does.
    """

    effects: tuple[str, ...]
    named: str
    by: str

    def __str__(self) -> str:
        pair = " and ".join(self.effects)
        if self.by == "both":
            return f"one of them cannot separate {pair}: both together name {self.named}"
        other, name = ("motion", "name") if self.by == "poses" else ("poses", "names")
        return f"the {other} cannot separate {pair}: the {self.by} {name} {self.named}"


def named_side(pair: NotSeparable, labels: Collection[str]) -> list[str]:
    """The sides of a pair whose effects are all among these labels. Where one side has the effects of the other and more, that is the only
    one that can be named: without the further ones the other is not confirmed.
    """
    parts = [set(side.split(TOGETHER)) for side in pair.effects]
    larger = [side for side, own, other in zip(pair.effects, parts, parts[::-1], strict=True) if own > other]
    return [side for side in larger or pair.effects if set(side.split(TOGETHER)) <= set(labels)]


def distance_of(key: str, mine: ParameterEstimate, theirs: ParameterEstimate) -> float:
    """Distance of two estimates in combined standard deviations."""
    sigmas = np.abs(apart(key, mine, theirs)) / np.maximum(np.hypot(mine.components[1], theirs.components[1]), 1e-300)
    if len(sigmas) == 1:
        return float(sigmas[0])
    probability = float(chdtrc(len(sigmas), np.sum(sigmas**2)))
    return float(-ndtri(probability / 2)) if probability > 0 else max(FARTHEST, float(sigmas.max()))
