"""Noise that grows with the reach is noticed, named and taken into account; noise that does not is left alone."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.model_fit import fit_model
from mbcacq.diagnosis.noise_dependence import ALL, INSTRUMENT, SquaresOfPoses, noise_variations
from mbcacq.diagnosis.problem import prepare
from mbcacq.estimation.forward_model import Displacements


def reach_of(obs):
    frames = obs.cell.robot.chain.frames(obs.q)
    return np.linalg.norm(frames[:, -1, :3, 3] - frames[:, 1, :3, 3], axis=1)


def farther(obs):
    """(P,) from nought at the nearest pose to one at the farthest."""
    reach = reach_of(obs)
    return (reach - reach.min()) / np.ptp(reach)


def noisier(obs, times, seed=1):
    """The recording with an instrument that is so many times as noisy at the farthest pose as at the nearest."""
    more = np.sqrt((1 + (times - 1) * farther(obs)) ** 2 - 1)[obs.pose]
    return replace(obs, xyz=obs.xyz + np.random.default_rng(seed).normal(size=obs.xyz.shape) * simulated.POINT_NOISE * more[:, None])


def test_noise_that_grows_with_reach_is_named_and_the_effect_beside_it_is_found(plan):
    obs = noisier(simulated.observe(plan, 7, [("joint_compliance", ("A2",), [3e-6], None)]), 3.4)
    found = diagnose(obs, folds=2)
    (one,) = found.noise_depends_on
    assert (one.of, one.covariate) == (INSTRUMENT, "reach")
    true = 1 + 2.4 * (np.array([one.low, one.high]) - reach_of(obs).min()) / np.ptp(reach_of(obs))
    assert one.sigma_high_mm / one.sigma_low_mm == pytest.approx(true[1] / true[0], rel=0.25)
    assert found.notes[0].startswith("the noise of the instrument grows with the reach: ")
    assert not any("correct noise_mm" in note for note in found.notes)
    assert [(e.name, e.where) for e in found.effects] == [("joint_compliance", ("A2",))]
    compliance = found.effects[0].parameters["A2.compliance_rad_per_Nm"]
    assert abs(compliance.value - 3e-6) < 3 * compliance.std


def test_each_pose_gets_its_own_noise(large_plan):
    ((_, scale),) = noise_variations(fit_model(prepare(noisier(simulated.observe(large_plan, 8), 3.4))))
    true = 1 + 2.4 * farther(large_plan)
    np.testing.assert_allclose(scale, true / np.exp(np.mean(np.log(true))), rtol=0.25)


def test_an_arm_that_sways_at_reach_is_no_noisier_instrument(medium_plan):
    def sways(context):
        rng, size = np.random.default_rng(4), 1e-5 + 1e-4 * farther(context.obs)
        return Displacements(joint=rng.normal(size=context.obs.q.shape) * size[:, None])

    found = noise_variations(fit_model(prepare(simulated.observe(medium_plan, 9, [sways]))))
    assert [entry.of for entry, _ in found] == [ALL]


def test_one_noise_for_all_poses_is_not_said_to_vary():
    """One in a hundred thousand recordings of noise would pass; a strong variation is seen."""
    rng, x = np.random.default_rng(3), np.linspace(0.0, 1.0, 60)
    dof = np.full(60, 18)
    gains = [SquaresOfPoses(rng.chisquare(dof), dof).varying(x)[1] for _ in range(1000)]
    assert np.quantile(gains, 0.95) == pytest.approx(3.84, rel=0.25)  # of a chi square distribution of one degree of freedom
    variance, gain = SquaresOfPoses(rng.chisquare(dof) * np.exp(1.5 * x), dof).varying(x)
    assert gain > 40
    assert np.log(variance[-1] / variance[0]) == pytest.approx(1.5, abs=0.5)
