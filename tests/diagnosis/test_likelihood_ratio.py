"""The likelihood-ratio test that knows the effect, against which the diagnosis is measured, keeps its level."""

from dataclasses import replace

import numpy as np
import simulated
from detection_power import likelihood_ratio, with_estimated_hypers
from scipy.stats import chi2, kstest

from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.effect_set import EffectSet, Member

SOUGHT = (
    "joint_scale:A2:q2:",
    "joint_scale:A5:q5:",
    "base_compliance:base:gravity_torque_2:",
    "ball_shift:ball4:x:",
    "joint_compliance:A3:gravity_torque_3:",
)


def test_likelihood_ratio_without_an_effect_is_chi_square(plan):
    tail = []
    for seed in range(16):
        setup = prepare(simulated.observe(plan, 900 + seed))
        wrong = np.log(np.concatenate([[1.2] * 3, [1.5] * 6, [1.0]]))
        setup = replace(setup, prior_noise=replace(setup.prior_noise, centre=setup.prior_noise.centre + wrong))
        sought = [c for c in setup.candidates if c.key in SOUGHT]
        tail += [chi2.sf(max(likelihood_ratio(setup, EffectSet((Member(c, None),))), 0.0), c.k) for c in sought]

    assert len(tail) == 16 * len(SOUGHT)
    assert kstest(tail, "uniform").pvalue > 0.01
    assert np.mean(np.array(tail) < 0.01) < 0.04


def test_likelihood_ratio_of_unknown_order_counts_the_choices(plan):
    tail = []
    for seed in range(12):
        setup = prepare(simulated.observe(plan, 920 + seed))
        for key in ("gear_transmission_error:A3:q3:", "mount_shift:mount:pose:"):
            candidate = next(c for c in setup.candidates if c.key == key)
            best, choices = with_estimated_hypers(setup, EffectSet((Member(candidate, 60.0),)))
            tail.append(choices * chi2.sf(max(likelihood_ratio(setup, best), 0.0), candidate.k))

    assert best.members[0].hyper != 60.0
    assert 0 < np.sum(np.array(tail) < 0.3) <= 14
    assert np.sum(np.array(tail) < 0.05) <= 4


def test_likelihood_ratio_finds_a_strong_effect(plan):
    setup = prepare(simulated.observe(plan, 950, [("joint_scale", ("A5",), [1.5e-4], None)]))
    candidate = next(c for c in setup.candidates if c.key == SOUGHT[1])

    assert likelihood_ratio(setup, EffectSet((Member(candidate, None),))) > 100
