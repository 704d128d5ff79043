"""An unmodelled function of one covariate over all that the joint can reach, as a Gaussian process with an estimated size.

What was learnt over a part of the range says less and less of what lies farther away. A process says how much less: beyond the data its
mean returns to what geometry has there, and its covariance to what such a function may be.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.posterior import relative_odds, reported_hypothesis
from mbcacq.diagnosis.nonparametric.gaussian_process import Process
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import evaluated
from mbcacq.effects.effect import label_of
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import SMOOTH, UNKNOWN, EffectTerm
from mbcacq.effects.functions import Column, DescribedPart, cosine, sine
from mbcacq.effects.learnt_range import is_angle
from mbcacq.effects.unmodelled import OPTIONS as GROUPS
from mbcacq.model.observations import Observations

LENGTHS = (0.4, 0.8, 1.6)  # rad, or of the largest moment: from a local bump to a quarter of a turn
TURN = 0.8  # rad, of the process that is the same a turn further on
WALLS = 0.2  # lengths beyond the range: a wall bends what is near to it
MOST_FUNCTIONS = 90
DRAWN = 400  # postures that show the range of a moment of gravity


def over_whole_range(here: Covariates, t: EffectTerm) -> list[EffectTerm]:
    """Processes of several lengths in the place of a joint's function of one angle or moment; a calibration estimates the size of each.

    Parameters
    ----------
    here : Covariates
        The recording in which the function was found.
    t : EffectTerm
        An unmodelled effect; it is returned as it is where it is no such function.
    """
    (first, *others), (name, *further) = t.parts, t.covariates
    if others or further or first.place != "joint" or not (is_angle(name) or name.startswith("gravity_")):
        return [t]
    found = evaluated(here, [first])[0].basis @ t.coefficients
    size, (low, high) = float(np.std(found)), reached(here, name)
    unit = 1.0 if is_angle(name) else max(abs(low), abs(high))
    several = dict[tuple[str, float], tuple[tuple[Column, ...], np.ndarray]]()
    for length in LENGTHS:
        away = WALLS * length * unit
        process = Process(t.depends_on, ((name, low - away, high + away),), length, unit)
        several["length", length] = process.functions(MOST_FUNCTIONS)
    if is_angle(name):
        orders = np.arange(1.0, GROUPS.few_order + 1)
        columns = (*(sine(name, k) for k in orders), *(cosine(name, k) for k in orders))
        several["turn", TURN] = columns, np.tile((1 + (TURN * orders) ** 2 / 5) ** -1.5, 2)
    out = list[EffectTerm]()
    for (hyper, length), (columns, relative) in several.items():
        sigma = size * relative / np.sqrt(np.sum(relative**2) / 2)  # of cosines, whose mean square is a half
        part, units = DescribedPart("joint", first.index, 0, columns), ("rad",) * len(columns)
        out.append(EffectTerm.of_group(here, t.where, t.depends_on, [part], sigma, units, variant=SMOOTH, hyper={hyper: length}))
    return out


def with_open_laws_as_functions(obs: Observations, kept: EffectModel, fit: EvidenceFit) -> EffectModel:
    """The model with a function of the joint's angle in the place of each law that nothing says to hold beyond the recording: a periodic
    error of which less than a period was seen, and a mechanism beside which the evidence does not exclude a function without a name."""
    here, terms, reported = Covariates(obs), dict[str, EffectTerm](), reported_hypothesis(fit)
    likely = [h for h in fit.hypotheses if relative_odds(h, reported) > OPTIONS.undecided]
    for t in kept.terms:
        label, general = (label_of(name, t.where) for name in (t.name, UNKNOWN))
        unfinished = t.periodic_in_own_angle and t.depends_on in t.clamped
        unnamed = any(map(is_angle, t.laws)) and any(general in h.labels and label not in h.labels for h in likely)
        terms |= {one.key: one for one in (over_whole_range(here, t) if unfinished or unnamed else [t])}
    return replace(kept, terms=tuple(terms.values()))


def reached(here: Covariates, name: str) -> tuple[float, float]:
    """Range of an angle (rad), or of a moment or direction of gravity, within the limits of the joints; and in the recording."""
    robot, recorded = here.obs.cell.robot, here.value(name)
    if is_angle(name):
        ends = robot.limits[here.tags.index(name[1:])]
    else:
        q = np.random.default_rng(0).uniform(robot.limits[:, 0], robot.limits[:, 1], (DRAWN, robot.n))
        ends = Covariates(EffectModel(robot, measurement=here.obs.cell.measurement).poses(q)).value(name)
    return float(min(np.min(ends), np.min(recorded))), float(max(np.max(ends), np.max(recorded)))
