"""How strong an effect must be to be found, against the likelihood-ratio test that knows which effect it is, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from mbcacq.challenge import made
from mbcacq.challenge.envelopes import CATALOGUED, Envelope
from mbcacq.challenge.oracle import true_members
from mbcacq.challenge.run import Challenger, plain
from mbcacq.challenge.score import at_place
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.price import Prices
from mbcacq.diagnosis.setup import prepare

LEVEL = 0.01        # of the test that knows: the rate of false alarms that the diagnosis as a whole is made for
ALLOWED = 0.02      # rate of false alarms over the whole catalogue
WANTED = 0.9


FAMILIES = len(CATALOGUED)


def least_gain(k: int, level: float = LEVEL) -> float:
    """Non-centrality at which a test of this level finds an effect of k coefficients nine times in ten."""
    limit = chi2.isf(level, k)
    return float(brentq(lambda gain: ncx2.sf(limit, k, gain) - WANTED, 1e-3, 1e4))


def searched(k: int, tries: float) -> float:
    """Multiple of that strength which the best test needs that does not know: one false alarm in fifty cells, shared alike by the
    catalogue's effects and by the places and values at which each is sought.
    """
    return float(np.sqrt(least_gain(k, ALLOWED / FAMILIES / tries) / least_gain(k)))


def found(challenger: Challenger, name: str, seed: int, multiples: Sequence[float]) -> tuple[list[bool], float]:
    """Whether the whole diagnosis, proof included, tells the effect at its place, at these multiples of the strength that the test needs
    which knows; and the multiple that the best test needs which must search.

    One cell, one drawn place and shape of the effect, noise as in any challenge.
    """
    envelope = Envelope(0, name, seed, (name,), seed + 1, 1.0)
    gauge, one = challenger.gauge, {"name": name, "strength": 1.0, "seed": seed + 1}
    gain = gauge.gain(envelope, [one])
    k, tries = sought(challenger, envelope, one)
    out = []
    for multiple in multiples:
        plainly = replace(envelope, seed=seed + int(1000 * multiple))
        strength = multiple * float(np.sqrt(least_gain(k) / gain))
        observations, told = made.observe(challenger.loaded, challenger.poses, plainly, [{**one, "strength": strength}])
        out.append(tells(diagnose(observations).as_json(), plain(told["effects"][0])))
    return out, searched(k, tries)


def tells(diagnosis: dict[str, Any], truth: dict[str, Any]) -> bool:
    """By name and at its place, or as one of two that these data cannot tell apart."""
    if any(e["name"] == truth["name"] and at_place(e, truth) for e in diagnosis["effects"]):
        return True
    apart = [label.split(":") for pair in diagnosis["not_separable"] for label in pair["effects"]]
    return any(name == truth["name"] and set(where.split("+")) <= set(truth["where"]) for name, where in apart)


def sought(challenger: Challenger, envelope: Envelope, one: dict) -> tuple[int, float]:
    """Coefficients of the true model, and the number of independent chances of its kind."""
    observations, told = made.observe(challenger.loaded, challenger.poses, envelope, [one])
    setup = prepare(observations)
    members = true_members(setup, plain(told["effects"][0]))
    prices = Prices(setup.candidates)
    return max(sum(c.k for c, _ in members), 1), min((prices.tries(c, h) for c, h in members), default=1.0)


def needed(multiples: Sequence[float], rates: Sequence[float]) -> float | None:
    """The multiple at which the rate, made monotonous, passes 90 %; None beyond the last."""
    rising = np.maximum.accumulate(np.asarray(rates, dtype=float))
    above = np.flatnonzero(rising >= WANTED)
    if not len(above):
        return None
    j = int(above[0])
    if j == 0:
        return float(multiples[0])
    share = (WANTED - rising[j - 1]) / max(rising[j] - rising[j - 1], 1e-12)
    return float(multiples[j - 1] + share * (multiples[j] - multiples[j - 1]))
