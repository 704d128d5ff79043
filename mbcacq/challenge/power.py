"""How strong an effect must be to be found, against the likelihood-ratio test that knows which effect it is, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from mbcacq.challenge import made
from mbcacq.challenge.envelopes import Envelope
from mbcacq.challenge.oracle import true_members
from mbcacq.challenge.run import Challenger, plain
from mbcacq.diagnosis.finding import find
from mbcacq.diagnosis.setup import prepare

LEVEL = 0.01        # of the test that knows: the rate of false alarms that the diagnosis as a whole is made for
WANTED = 0.9


def least_gain(k: int) -> float:
    """Non-centrality at which the test that knows finds an effect of k coefficients nine times in ten."""
    limit = chi2.isf(LEVEL, k)
    return float(brentq(lambda gain: ncx2.sf(limit, k, gain) - WANTED, 1e-3, 1e4))


def found(challenger: Challenger, name: str, seed: int, multiples: Sequence[float]) -> list[bool]:
    """Whether the diagnosis names the effect at its place, at these multiples of the strength the test that knows needs.

    One cell, one drawn place and shape of the effect, noise as in any challenge.
    """
    envelope = Envelope(0, name, seed, (name,), seed + 1, 1.0)
    gauge, one = challenger.gauge, {"name": name, "strength": 1.0, "seed": seed + 1}
    gain = gauge.gain(envelope, [one])
    out = []
    for multiple in multiples:
        plainly = replace(envelope, seed=seed + int(1000 * multiple))
        k = coefficients(challenger, plainly, one)
        strength = multiple * float(np.sqrt(least_gain(k) / gain))
        observations, told = made.observe(challenger.loaded, challenger.poses, plainly, [{**one, "strength": strength}])
        truth = plain(told["effects"][0])
        model = find(prepare(observations)).model
        out.append(any(c.name == name and set(c.where) <= set(truth["where"]) for c, _ in model.members))
    return out


def coefficients(challenger: Challenger, envelope: Envelope, one: dict) -> int:
    """Of the true model."""
    observations, told = made.observe(challenger.loaded, challenger.poses, envelope, [one])
    members = true_members(prepare(observations), plain(told["effects"][0]))
    return max(sum(c.k for c, _ in members), 1)


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
