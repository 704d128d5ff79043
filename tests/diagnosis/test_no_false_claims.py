"""Nothing is claimed on clean data, what is missing is reported, an unmodelled effect is located and not named."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.evidence.evidence_fit import kept_centres
from mbcacq.diagnosis.evidence.hypothesis import under
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.nonparametric.joint_model import RandomEffect
from mbcacq.diagnosis.output.notes import not_carried_over, rejected_balls, rejected_poses, single_place
from mbcacq.diagnosis.output.text import words
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.folds import all_but, split
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore
from mbcacq.diagnosis.verdict import conclude, verdict_of
from mbcacq.errors import CalibrationError
from mbcacq.estimation.adjustment import adjust_recording
from mbcacq.estimation.forward_model import Displacements
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.variance_components import pack


@pytest.mark.parametrize("seed", range(4))
def test_clean_cells_are_clean(plan, seed):
    found = model_fit.fit_model(prepare(simulated.observe(plan, 100 + seed)))

    assert verdict_of(found) == "none"
    assert found.model.members == ()


def test_clean_cells_with_outliers_are_clean(plan):
    found = model_fit.fit_model(prepare(simulated.observe(plan, 105, outliers=0.01)))

    assert verdict_of(found) == "none"


def test_held_out_figures_count_the_centres_that_a_fit_rejects(plan):
    found = diagnose(simulated.observe(plan, 105, outliers=0.02), folds=2).fit.held_out

    rejected = found.centres - found.robust_centres
    assert found.centres == plan.n_centres
    assert 0 < rejected < 0.04 * plan.n_centres
    assert found.before_rms_mm < 0.02  # the robust figure: noise
    assert found.every_before_rms_mm == pytest.approx(3.0 * np.sqrt(3 * rejected / plan.n_centres), rel=0.4)


def test_noise_is_estimated_whatever_the_cell_file_says(plan):
    reported = replace(plan, cell=replace(plan.cell, noise_mm=None))

    found = model_fit.fit_model(prepare(simulated.observe(reported, 106)))

    np.testing.assert_allclose(found.noise.point, simulated.POINT_NOISE, rtol=0.15)
    np.testing.assert_allclose(np.exp(np.mean(np.log(found.noise.joint))), simulated.JOINT_NOISE, rtol=0.25)


@pytest.mark.parametrize("seed", [4, 28, 47, 53])
def test_the_noise_of_twelve_poses_of_a_bar_is_estimated_though_stated_five_times_too_small(seed):
    """Under the stated noise many centres are outliers, and what is left does not determine the cell."""
    plan = simulated.plan(stations=2, bars=2, each=4)
    obs = simulated.observe(plan.select(np.isin(np.arange(plan.n_poses), np.linspace(0, plan.n_poses - 1, 12).round())), seed)
    true = obs.cell.noise_mm
    stated = replace(obs, cell=replace(obs.cell, noise_mm=true / 5))
    found = adjust_recording(stated, CalibrationOptions(refuse=False))
    assert found.used.all()
    assert np.all(np.abs(np.log(found.noise.point / true)) < np.log(3))


def test_effects_without_their_columns_are_reported_as_dropped(plan):
    bare = replace(simulated.observe(plan, 107), time_s=None, direction=None, temperatures={})

    dropped = prepare(bare).dropped

    assert {"scanner_warmup", "thermal_growth", "exposure_latency"} <= set(dropped)
    assert "temperatures" in dropped["thermal_growth"]


@pytest.mark.parametrize(("places", "left_out"), [(1, "block"), (2, "station"), (3, "station")])
def test_a_place_is_left_out_where_there_are_two(plan, places, left_out):
    linear = prepare(plan.select(plan.station < places)).linear

    fold, what = split(linear, 4)

    assert what == left_out
    if places > 1:
        assert all(len(set(fold[linear.obs.station == s])) == 1 for s in range(places))
        assert len(set(fold)) == places


@pytest.mark.parametrize(("places", "left_out"), [(1, "block"), (2, "station")])
def test_no_recording_of_several_is_left_out_whole(plan, places, left_out):
    linear = prepare([simulated.observe(plan.select(plan.station < places), seed) for seed in (1, 2)]).linear

    fold, what = split(linear, 4)

    assert what == left_out
    for left in range(4):
        assert set(linear.obs.recording[fold != left]) == {0, 1}


@pytest.mark.parametrize(("places", "said"), [(1, True), (2, False)])
def test_with_one_place_a_note_says_that_no_other_was_tested(plan, places, said):
    problem = prepare(plan.select(plan.station < places))

    assert any("not shown that the model holds at other places" in note for note in single_place(problem)) == said


def bending_of_link_two(context):
    """Rotation behind link 2 about its own x, by the product of two joint angles: in no catalogue."""
    frame = np.zeros((context.obs.n_poses, context.n + 1, 6))
    frame[:, 2, 3] = 3e-4 * np.sin(2 * context.obs.q[:, 2])
    return Displacements(frame=frame)


def test_an_unmodelled_effect_is_not_explained_by_a_parametric_one(plan):
    found = model_fit.fit_model(prepare(simulated.observe(plan, 108, [bending_of_link_two])))

    assert verdict_of(found) in ("unexplained", "partly_explained")
    assert found.random


def cubic_lens(context):
    point = np.zeros((context.obs.n_centres, 3))
    point[:, 2] = 0.03 * (context.obs.xyz[:, 0] / 30) ** 3
    return Displacements(point=point)


def test_an_unmodelled_scanner_error_is_located_in_the_scanner(large_plan):
    found = model_fit.fit_model(prepare(simulated.observe(large_plan, 109, [cubic_lens])))

    assert verdict_of(found) in ("unexplained", "cannot_tell")  # what stands beside it is open, not where it is
    assert (found.cells[0].location, found.cells[0].depends_on) == ("scanner", "x")


def test_too_few_poses_are_refused(plan):
    few = plan.select(np.arange(plan.n_poses) < 8)

    with pytest.raises(CalibrationError, match="too few"):
        diagnose(few)


def test_what_parts_of_a_recording_do_not_confirm_is_said_to_be_uncertain_beyond_it():
    def scores(chi2):
        one = PredictiveScore(1.0, 100, chi2, 300.0)
        return CrossValidation(one, one, "station", {})

    (note,) = not_carried_over("explained", scores(900.0))
    assert "3.0 times the variance" in note
    assert "may not hold at others" in note
    assert not not_carried_over("explained", scores(310.0))
    assert not not_carried_over("partly_explained", scores(900.0))


def test_a_pose_that_was_rejected_as_a_whole_may_show_an_effect(plan):
    keep = np.ones(plan.n_centres, dtype=bool)
    keep[np.flatnonzero(plan.pose == 3)[0]] = False
    assert rejected_poses(plan, keep) == []
    keep[plan.pose == 3] = False
    assert rejected_poses(plan, keep)[0].startswith(
        f"all centres of pose {plan.pose_id[3]} were rejected: that may be an effect of few poses"
    )
    keep[plan.pose == 5] = False
    assert f"all centres of 2 poses ({plan.pose_id[3]}, {plan.pose_id[5]}) were rejected" in rejected_poses(plan, keep)[0]


def test_what_happened_at_one_station_is_not_judged_by_leaving_that_station_out():
    one = PredictiveScore(1.0, 100, 900.0, 300.0)
    drift = EffectFound(name="station_drift", where=("station3",), parameters={}, p_value=1e-30, held_out_gain=0.1)
    (note,) = not_carried_over("explained", CrossValidation(one, one, "station", {}), [drift])
    assert "what happens at station3 alone is not known where the whole station is left out" in note
    little = PredictiveScore(1.0, 100, 390.0, 300.0)  # beyond noise, and less than is spoken of else
    assert not_carried_over("explained", CrossValidation(little, little, "station", {}), [drift]) == [note]
    (note,) = not_carried_over("explained", CrossValidation(one, one, "block", {}), [drift])
    assert "3.0 times the variance" in note


def test_what_does_not_predict_held_out_poses_explains_nothing(plan):
    problem = prepare(simulated.observe(plan, 21, [("joint_compliance", ("A2",), [2.5e-6], None)]))
    fit = model_fit.fit_model(problem)
    assert verdict_of(fit) == "explained"
    alike = PredictiveScore(square=0.1, count=100, chi2=400.0, dof=300.0)
    useless = CrossValidation(alike, alike, "block", dict.fromkeys(fit.model.names, alike))

    found = conclude(problem, fit, useless)

    assert [e.trend for e in found.effects] == ["held-out data are predicted as well without it"]
    assert found.verdict == "cannot_tell"


def test_without_something_unmodelled_the_names_that_a_part_gave_to_it_are_left_out_as_well():
    named, elsewhere, reported = (
        simulated.candidate(*of, [1.0]) for of in (("lost_motion", "A3"), ("lost_motion", "A2"), ("backlash", "A3"))
    )
    model = EffectSet(tuple(Member(c, None) for c in (named, elsewhere, reported)))
    groups = [RandomEffect("A3", "gravity_torque_3", (), np.ones(1)), RandomEffect("link3", "q3", (), np.ones(1))]

    assert all_but(model, groups, "unknown:A3", ("unknown:A3", "backlash")) == ([1, 2], [1])
    assert all_but(model, groups, "backlash", ("unknown:A3", "backlash")) == ([0, 1], [0, 1])


def test_no_centre_stands_out_of_noise_that_is_as_large_as_a_gross_error(plan):
    problem = prepare(simulated.observe(plan, 105, outliers=0.02))
    coarse = Noise(np.full(3, 4.0), np.full(6, 1e-5), 1e-3)

    def kept(noise):
        return kept_centres(under(NoisePoint(problem.linear, problem.prior_noise, pack(noise)), (), 0.0))

    assert kept(coarse).all()
    assert 0 < np.sum(~kept(problem.noise)) < 0.04 * plan.n_centres


def test_a_ball_of_which_every_centre_is_rejected_is_named_and_not_called_no_effect():
    """It lies in its seat another way at each station: no shift of the ball describes it."""
    obs = simulated.observe(simulated.plan(8, 0, 6), 131, [])
    assert rejected_balls(obs, np.ones(obs.n_centres, bool)) == []
    moved = np.random.default_rng(3).normal(size=(8, 3))
    moved *= 0.15 / np.linalg.norm(moved, axis=1, keepdims=True)
    loose = (obs.ball == 3)[:, None] * moved[obs.station[obs.pose]]
    found = diagnose(replace(obs, xyz=obs.xyz + loose), workers=1)
    assert found.verdict != "none"
    assert "48 of its 48 centres were rejected" in found.advice[0].reason
    assert "What and where: not known; look at ball 4\n" in words(found)
