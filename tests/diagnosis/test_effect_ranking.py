"""Which effect is the most probable, how often noise is taken for one, and which effects predict data left out."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from scipy.stats import chi2

from mbcacq.diagnosis import diagnose, model_fit
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.verdict import verdict_of
from mbcacq.effects import over_time
from mbcacq.estimation.forward_model import Displacements


@pytest.mark.parametrize("k", [1, 6])
@pytest.mark.parametrize("level", [0.05, 0.005])
def test_number_of_independent_moments_gives_the_false_alarm_rate(plan, k, level):
    """White noise cut in two at every moment: the best cut passes the threshold as seldom as is said, and not much more seldom."""
    setup = prepare(plan)
    hyper = over_time.moment(setup.context)
    n, rng = plan.n_poses, np.random.default_rng(5)
    first = np.arange(n)[None] >= hyper.values[:, None]
    column = first - first.mean(axis=1, keepdims=True)
    column /= np.linalg.norm(column, axis=1, keepdims=True)
    best = np.array([np.max(np.sum((column @ rng.normal(size=(n, k))) ** 2, axis=1)) for _ in range(4000)])

    rate = np.mean(best > chi2.isf(level / hyper.independent, k))

    assert 0.25 * level < rate < 1.3 * level


def test_a_mount_shift_is_not_reported_as_scanner_warmup(large_plan):
    """Both change slowly with time; of six components, one step explains more than three that fade."""
    observed = simulated.observe(large_plan, 131, [("mount_shift", ("mount",), [0.009, 0.006, -0.0075, 4.5e-5, -3e-5, 1.5e-5], 60.0)])

    assert model_fit.fit_model(prepare(observed)).model.names == ("mount_shift",)


def test_a_shifted_ball_is_reported_as_a_parametric_effect(large_plan):
    observed = simulated.observe(large_plan, 132, [("ball_shift", ("ball3",), [0.006, -0.003, 0.0045], None)])

    found = model_fit.fit_model(prepare(observed))

    assert found.model.names == ("ball_shift",)
    assert not found.random


def test_strong_structure_that_predicts_nothing_is_reported_unknown(plan):
    """A ball that comes loose lies elsewhere at every station: no other station knows where, but it is no noise."""

    def loose(s):
        ball = np.zeros(s.obs.xyz.shape)
        lies = np.random.default_rng(6).normal(0, 0.02, (len(s.obs.cell.stations), 3))
        mine = s.obs.ball == 2
        ball[mine] = lies[s.obs.station[s.obs.pose[mine]]]
        return Displacements(ball=ball)

    reported = diagnose.diagnose(simulated.observe(plan, 166, [loose]), folds=2)

    assert reported.verdict == "unexplained"
    assert reported.mismatch[0].at == "ball3"
    assert [(e.name, e.where) for e in reported.effects] == [("unknown", ("ball3",))]


def test_one_unmodelled_effect_is_not_split_into_many_parametric_ones(plan):
    def twist(s):
        frame = np.zeros((s.obs.n_poses, s.n + 1, 6))
        moment = s.gravity_moment(2)[:, 0]
        frame[:, 2, 3] = 6e-4 * np.tanh(moment / (0.5 * moment.std()))
        return Displacements(frame=frame)

    found = model_fit.fit_model(prepare(simulated.observe(plan, 168, [twist])))

    assert found.model.members == ()
    assert found.cells[0].location == "link2"


def test_two_effects_are_named_although_one_block_would_fit_both(plan):
    two = [("joint_compliance", ("A2",), [2.5e-6], None), ("joint_scale", ("A5",), [3e-4], None)]

    found = model_fit.fit_model(prepare(simulated.observe(plan, 168, two)))

    assert found.model.names == ("joint_compliance", "joint_scale")
    assert not found.random


def test_a_station_drift_is_validated_on_the_other_stations(plan):
    """None of them knows of it: left out itself, its station remains as bad as it was."""
    observed = simulated.observe(plan, 134, [("station_drift", ("station3",), [0.3, -0.25, 0.4], None)])

    reported = diagnose.diagnose(observed, folds=2)

    assert [(e.name, e.where) for e in reported.effects] == [("station_drift", ("station3",))]
    assert reported.fit.held_out.split == "station"
    assert reported.fit.held_out.after_chi2_dof > 2.0
    assert reported.verdict == "explained"


def test_a_moment_among_poses_left_out_does_not_count_against_a_step(medium_plan):
    """Without the station in which an encoder jumped nobody knows at which of its poses."""
    observed = simulated.observe(medium_plan, 137, [("joint_step", ("A2",), [8e-4], 52.0)])

    reported = diagnose.diagnose(observed, folds=2)

    assert (medium_plan.station == medium_plan.station[52]).sum() > 4
    assert reported.effects[0].parameters["A2.at_pose"].value == 52
    assert reported.fit.held_out.split == "station"
    assert reported.fit.held_out.after_chi2_dof < 1.2
    assert reported.verdict == "explained"


def test_rejected_centres_that_an_effect_explains_are_readmitted(large_plan):
    """A belt of the wrist that skips a tooth near the end, by a degree: four centres far from its axis look like accidents."""
    cell = large_plan.cell
    driven = replace(large_plan, cell=replace(cell, robot=replace(cell.robot, drives=(None,) * 5 + ("belt",))))
    setup = prepare(simulated.observe(driven, 135, [("joint_step", ("A6",), [2e-2], 110.0)]))

    found = model_fit.fit_model(setup)
    rejected = ~found.geometry_only.linear.keep

    assert np.sum(~setup.linear.keep) > 3
    assert np.sum(rejected) <= 1  # a degree is not small: the linear column of the step misses its far centres by 0.1 mm
    assert [m.candidate.key for m in found.model.members] == ["joint_step:A6:pose:"]


def test_a_ball_far_off_is_reported_as_a_shifted_ball(plan):
    """However far: an effect is not given up for its size while nothing else fits better."""
    observed = simulated.observe(plan, 135, [("ball_shift", ("ball5",), [1.5, -1.0, 1.0], None)])

    found = model_fit.fit_model(prepare(observed))

    assert [m.candidate.location for m in found.model.members] == [("ball_shift", ("ball5",))]
    assert verdict_of(found) == "explained"


def test_two_scales_that_one_artefact_cannot_separate_are_reported():
    observed = simulated.observe(simulated.plan(bars=0), 136, [("scanner_scale", ("scanner",), [300.0], None)])

    reported = diagnose.diagnose(observed, folds=2)

    named = {reported.effects[0].name, *(a.name for a in reported.effects[0].alternatives)}
    assert reported.verdict == "cannot_tell"
    assert {"scanner_scale", "artefact_expansion"} <= named
