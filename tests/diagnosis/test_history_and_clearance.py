"""What a pose owes to what came before it, and a scanner with play in its mount: named where they are, and never taken for noise."""

from dataclasses import replace

import numpy as np
import simulated

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.effects.covariates import Covariates
from mbcacq.estimation.forward_model import Displacements


def with_pauses(obs):
    """The arm stands for four minutes before each station."""
    first = np.r_[True, np.diff(obs.station) != 0]
    return replace(obs, time_s=np.cumsum(np.where(first, 250.0, 20.0)))


def test_a_pause_is_known_and_what_passed_since_it(medium_plan):
    here = Covariates(with_pauses(medium_plan))
    first = np.r_[True, np.diff(medium_plan.station) != 0]
    np.testing.assert_allclose(here.pause, np.where(first, 250.0, 20.0))
    np.testing.assert_array_equal(here.since_pause, 20.0 * here.visit)
    np.testing.assert_array_equal(here.visit == 0, first)


def test_a_sag_after_pauses_is_history_of_its_joint(medium_plan):
    paused = with_pauses(medium_plan)

    def sag(context):
        return Displacements(joint=1.1e-4 * np.eye(6)[1] * (context.pause > 100.0)[:, None])

    found = diagnose(simulated.observe(paused, 5, [sag]), folds=2)

    (effect,) = found.effects
    assert (effect.name, effect.where, found.verdict) == ("joint_settling", ("A2",), "explained")
    np.testing.assert_allclose(abs(effect.parameters["A2.sag_deg"].value), np.degrees(1.1e-4), rtol=0.2)


def test_a_loose_mount_is_found_with_both_seats(medium_plan):
    line = np.array([0.48, 0.6, 0.64])
    half = np.array([0.02, 0.0, 0.015, 0.0, 1.5e-4, 0.0])

    def loose(context):
        frame = np.zeros((context.obs.n_poses, 7, 6))
        frame[:, 6] = np.sign(context.flange_gravity @ line)[:, None] * half
        return Displacements(frame=frame)

    found = diagnose(simulated.observe(medium_plan, 6, [loose]), folds=2)

    (effect,) = found.effects
    assert (effect.name, effect.where) == ("mount_clearance", ("mount",))
    np.testing.assert_allclose(np.abs(effect.parameters["turn_deg"].value), np.degrees(2 * np.abs(half[3:])), atol=4e-3)


def test_joints_that_repeat_worse_than_their_data_sheet_are_not_the_measured_noise(medium_plan):
    found = diagnose(simulated.observe(medium_plan, 7, joint_noise=8e-5), folds=2)

    assert found.verdict not in ("none", "explained")
    assert any("worse than the data sheet" in note for note in found.notes)
