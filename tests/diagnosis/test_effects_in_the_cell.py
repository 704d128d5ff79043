"""What was found comes back: effects as terms of the cell, fitted, held, written, read and applied."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import simulated

import mbcacq
from mbcacq.calibration import with_effects
from mbcacq.calibration.calibrate import calibrate, calibrate_with_effects
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.transfer import check_transfer
from mbcacq.diagnosis.output.kept_model import partly_covered, term_of
from mbcacq.effects import catalogue, unmodelled
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import evaluated, parts_of
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import LearntRecording
from mbcacq.errors import ConfigError
from mbcacq.estimation import forward_model
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.json_text import from_fields

COMPLIANCE, GEAR = 3e-6, (8e-5, -5e-5)
OPTIONS = CalibrationOptions(refuse=False)  # a few poses of each station: what geometry alone leaves open is held


@pytest.fixture(scope="module")
def context(plan):
    state = simulated.nominal_state(plan)
    return Context(plan, state, forward_model.predict(plan, state))


@pytest.fixture(scope="module")
def recording(plan):
    effects = [("joint_compliance", ("A2",), [COMPLIANCE], None), ("gear_transmission_error", ("A4",), list(GEAR), 2.0)]
    return simulated.observe(plan, 7, effects)


@pytest.fixture(scope="module")
def model(context):
    every = catalogue.candidates(context)[0]
    soft = next(c for c in every if c.name == "joint_compliance" and c.where == ("A2",))
    gear = next(c for c in every if c.name == "gear_transmission_error" and c.where == ("A4",))
    terms = (term_of(context, soft, None, np.zeros(1), np.zeros(1)), term_of(context, gear, 2.0, np.zeros(2), np.zeros(2)))
    return EffectModel(context.obs.cell.robot, terms, LearntRecording.of(context.obs))


@pytest.fixture(scope="module")
def fitted(recording, model):
    return calibrate_with_effects(recording, OPTIONS, model)


def test_an_effect_that_was_kept_in_a_file_displaces_the_same(context):
    for candidate in catalogue.candidates(context)[0]:
        value = None if candidate.hyper is None else float(candidate.hyper.values[len(candidate.hyper.values) // 3])
        kept = term_of(context, candidate, value, np.zeros(candidate.k), np.zeros(candidate.k))
        again = EffectModel.from_dict(json.loads(json.dumps(EffectModel(context.obs.cell.robot, (kept,)).to_dict()))).terms[0]
        written = again.parts_at(Covariates(context.obs), LearntRecording.of(context.obs))
        for one, other in zip(parts_of(candidate, context, value), written, strict=True):
            assert (one.place, one.index, one.component) == (other.place, other.index, other.component)
            np.testing.assert_allclose(other.basis, one.basis, atol=1e-12 * max(np.abs(one.basis).max(), 1e-30), err_msg=candidate.key)


def test_effects_are_fitted_with_the_geometry(recording, fitted):
    soft, gear = fitted.effects.terms
    assert abs(soft.coefficients[0] - COMPLIANCE) < 4 * soft.std[0]
    assert np.all(np.abs(gear.coefficients - GEAR) < 4 * gear.std)
    assert fitted.fit.chi2 / fitted.fit.dof < 1.1
    assert fitted.extra["geometry_alone"]["rms_mm"] > 1.5 * fitted.fit.rms_mm


def test_held_effects_keep_their_coefficients(recording, fitted):
    held = calibrate_with_effects(recording, OPTIONS, fitted.effects, hold=True)
    np.testing.assert_array_equal(held.effects.terms[0].coefficients, fitted.effects.terms[0].coefficients)
    assert held.fit.rms_mm == pytest.approx(fitted.fit.rms_mm, rel=0.02)  # other parameters are determined
    assert not any("compliance" in name for name in held.names)


def test_a_result_that_was_written_places_points_as_before(recording, fitted):
    back = CalibratedCell.from_json(fitted.to_json())
    rng = np.random.default_rng(0)
    q, xyz = rng.uniform(-1, 1, (20, 6)), rng.uniform(-30, 30, (20, 3))
    np.testing.assert_allclose(back.to_base(q, xyz), fitted.to_base(q, xyz), atol=1e-9)
    np.testing.assert_allclose(back.point_covariance(q, xyz), fitted.point_covariance(q, xyz), rtol=1e-6)
    geometry = replace(fitted, effects=None)
    assert np.abs(geometry.to_base(q, xyz) - fitted.to_base(q, xyz)).max() > 0.05


def test_the_derivative_by_a_coefficient_is_that_of_the_placed_point(fitted):
    rng = np.random.default_rng(1)
    q, xyz = rng.uniform(-1, 1, (6, 6)), rng.uniform(-30, 30, (6, 3))
    column = fitted.names.index(fitted.effects.terms[0].names[0])
    step = 1e-7
    moved = replace(fitted.effects.terms[0], coefficients=fitted.effects.terms[0].coefficients + step)
    other = replace(fitted, effects=replace(fitted.effects, terms=(moved, *fitted.effects.terms[1:])))
    slope = (other.to_base(q, xyz) - fitted.to_base(q, xyz)) / step
    np.testing.assert_allclose(fitted.point_columns(q, xyz)[:, :, column], slope, rtol=2e-3, atol=1e-3 * np.abs(slope).max())


def test_an_arm_and_its_effects_hold_on_another_day(plan, recording, fitted):
    other = simulated.observe(
        plan, 7, [("joint_compliance", ("A2",), [COMPLIANCE], None), ("gear_transmission_error", ("A4",), list(GEAR), 2.0)]
    )
    tried = check_transfer(replace(other, pose_id=other.pose_id + 1000), fitted)
    assert tried.with_effects.rms_mm < 0.5 * tried.geometry_alone.rms_mm
    assert {e.name for e in tried.effects} == {"joint_compliance", "gear_transmission_error"}
    assert all(e.gain > 0 for e in tried.effects)
    assert tried.parts_left_out is None  # neither of them differs from one day to the next, nor ends where it was learnt
    low, high = tried.normalised_error.usual
    assert 0.7 < low < tried.normalised_error.rms < high < 1.3
    assert from_fields(type(tried), json.loads(json.dumps(tried.to_dict()))) == tried


@pytest.mark.parametrize("place", ["fitted", "known"])
def test_poses_without_a_centre_say_nothing_of_another_day(recording, fitted, place):
    unseen = np.isin(recording.pose, [0, 3, recording.n_poses - 1])
    day = replace(recording, pose_id=recording.pose_id + 1000, **{c: getattr(recording, c)[~unseen] for c in ("pose", "ball", "xyz")})
    without = day.select(np.isin(np.arange(day.n_poses), day.pose))

    tried, expected = (check_transfer(one, fitted, place=place) for one in (day, without))

    assert tried == expected
    assert tried.poses == recording.n_poses - 3


def test_a_check_that_fails_loses_nothing_of_the_diagnosis():
    recording = simulated.observe(simulated.plan(stations=4, bars=2, each=6), 8, [("joint_compliance", ("A2",), [5e-6], None)])
    few = recording.select(np.arange(recording.n_poses) < 1)
    few = replace(few, **{column: getattr(few, column)[:1] for column in ("pose", "ball", "xyz")})  # one centre places no station
    found = mbcacq.diagnose(recording, check=[few, recording], workers=1)
    assert [e.name for e in found.effects] == ["joint_compliance"]
    assert len(found.checks) == 1
    assert [n for n in found.poses.notes if n.startswith("what was found could not be tried on the other recording: ")]


def test_a_check_of_another_arm_is_refused_before_the_diagnosis(recording):
    other = replace(recording, cell=replace(recording.cell, robot=replace(recording.cell.robot, name="another arm")))
    steps = []
    with pytest.raises(ConfigError, match="the other recording is of 'another arm'"):
        mbcacq.diagnose(recording, check=[other], progress=steps.append)
    assert not steps


def test_with_known_places_nothing_is_fitted(recording, fitted):
    tried = check_transfer(recording, fitted, place="known")
    assert tried.with_effects.rms_mm == pytest.approx(fitted.fit.rms_mm, rel=0.05)  # balls as certified
    assert tried.geometry_alone.rms_mm > 2 * tried.with_effects.rms_mm
    elsewhere = tuple(replace(s, id=f"elsewhere {s.id}") for s in recording.cell.stations)
    moved = replace(recording, cell=replace(recording.cell, stations=elsewhere))
    with pytest.raises(ConfigError, match="no station of the recording .* has a known place"):
        check_transfer(moved, fitted, place="known")


def test_a_hand_eye_transform_alone_is_tried_on_a_recording(recording):
    """Nothing of the arm was learnt then: what its uncertainty adds to that of the noise is nothing."""
    cell = calibrate(recording, replace(OPTIONS, kinematics=False))
    again = CalibratedCell.from_json(cell.to_json())
    assert np.isfinite(check_transfer(recording, again).normalised_error.rms)


def test_effects_of_another_arm_are_refused(recording, fitted):
    wrong = replace(fitted.effects, robot=replace(fitted.effects.robot, name="another arm"))
    with pytest.raises(ConfigError, match="learnt on 'another arm'"):
        calibrate_with_effects(recording, None, wrong)


def test_groups_nobody_needs_vanish_and_others_find_their_size(plan, recording):
    here = Covariates(recording)
    wanted = [unmodelled.group(here, "A2", "gravity_torque_2"), unmodelled.group(here, "A4", "q4"), unmodelled.group(here, "A6", "q6")]
    model = EffectModel(plan.cell.robot, tuple(wanted), LearntRecording.of(recording))
    found = calibrate_with_effects(recording, OPTIONS, model)
    kept = {t.where[0] for t in found.effects.terms}
    assert {"A2", "A4"} <= kept
    assert found.fit.chi2 / found.fit.dof < 1.15
    assert found.fit.rms_mm < 0.7 * calibrate(recording, replace(OPTIONS, discrepancy=False)).fit.rms_mm


def test_sizes_found_by_some_of_the_poses_lead_to_the_coefficients_of_all(plan, recording, monkeypatch):
    wanted = (unmodelled.group(Covariates(recording), "A2", "gravity_torque_2"),)
    model = EffectModel(plan.cell.robot, wanted, LearntRecording.of(recording))
    whole = calibrate_with_effects(recording, OPTIONS, model)
    monkeypatch.setattr(with_effects, "OPTIONS", replace(with_effects.OPTIONS, most_poses=64))
    found = calibrate_with_effects(recording, OPTIONS, model)
    assert found.fit.observations.n_poses == recording.n_poses
    (a,), (b,) = whole.effects.terms, found.effects.terms
    assert np.all(np.abs(a.coefficients - b.coefficients) < 0.5 * a.std)
    np.testing.assert_allclose(b.std, a.std, rtol=0.3)
    np.testing.assert_allclose(found.fit.rms_mm, whole.fit.rms_mm, rtol=0.1)


def moved_to(plan, seed, size):
    """A recording whose joint 4 stands ahead of what it reports, by up to ``size`` (rad), after each movement; and by how much (P,)."""
    clean = simulated.observe(plan, seed, [])
    movement = np.random.default_rng(4).choice([-1.0, 1.0], clean.q.shape) * np.geomspace(0.001, 0.5, clean.n_poses)[:, None]
    ahead = size * np.tanh(movement[:, 3] / np.radians(1.0))
    q = clean.q.copy()
    q[:, 3] -= ahead
    return replace(clean, q=q, movement=movement), ahead


@pytest.fixture(scope="module")
def after_movements(large_plan):
    obs, ahead = moved_to(large_plan, 8, 3e-4)
    here = Covariates(obs)
    wanted = tuple(unmodelled.group(here, f"A{i}", f"movement_{i}") for i in (2, 4))
    return calibrate_with_effects(obs, OPTIONS, EffectModel(obs.cell.robot, wanted, LearntRecording.of(obs))), obs, ahead


def test_what_a_movement_leaves_behind_is_found_by_its_length(after_movements):
    found, obs, ahead = after_movements
    turned = found.effects.displacements(obs).joint
    assert np.sqrt(np.mean((turned[:, 3] - ahead) ** 2)) < 0.2 * np.sqrt(np.mean(ahead**2))
    assert np.sqrt(np.mean(turned[:, 1] ** 2)) < 0.05 * np.sqrt(np.mean(ahead**2))
    for other in (replace(obs, movement=None), replace(obs, pose_id=obs.pose_id + 1000)):  # at rest; in another recording
        assert not np.any(found.effects.displacements(other).joint)


def test_the_uncertainty_elsewhere_includes_what_movements_leave_behind_there(large_plan, after_movements):
    found = after_movements[0]
    other, _ = moved_to(large_plan, 8, -3e-4)  # of the same size, at another speed with the other sign
    other = replace(other, pose_id=other.pose_id + 1000)
    stated = check_transfer(other, found).normalised_error.rms
    silent = check_transfer(other, replace(found, effects=found.effects.select(lambda t: False))).normalised_error.rms
    assert 0.7 < stated < 1.5
    assert silent > 2 * stated


@pytest.mark.parametrize("ahead", [0.0, -3e-4])
def test_what_movements_leave_behind_on_another_day_is_predicted_there_by_other_parts_of_it(large_plan, after_movements, ahead):
    found = after_movements[0]
    other, _ = moved_to(large_plan, 8, ahead)
    other = replace(other, pose_id=other.pose_id + 1000)
    left = check_transfer(other, found).parts_left_out
    assert 0.8 < left.drawn_anew.chi2_dof < 1.3
    ratio = left.drawn_anew.rms_mm / left.as_learnt.rms_mm
    assert ratio < 0.5 if ahead else 0.97 < ratio < 1.03  # of what does not happen there nothing is gained


def test_an_arm_that_was_learnt_wrongly_is_not_excused_by_what_differs(large_plan, after_movements):
    found = after_movements[0]
    other, _ = moved_to(large_plan, 8, -3e-4)
    chain = found.state.chain
    bent = replace(found, state=replace(found.state, chain=replace(chain, a=chain.a + np.array([0, 1.0, 0, 0, 0, 0]))))
    tried = check_transfer(replace(other, pose_id=other.pose_id + 1000), bent)
    assert tried.parts_left_out.drawn_anew.chi2_dof > 10


def first_left(fitted, obs):
    """(P,) bool of the poses that leave the learnt range of q4."""
    (known,) = {t.ranges["q4"] for t in fitted.effects.terms if "q4" in t.ranges}
    return known.outside("q4", obs.q[:, 3])


def test_what_is_unmodelled_is_less_and_less_where_it_was_not_learnt(recording):
    """A smooth function of an angle says little of angles far from all poses; its prior is what is known there."""
    near = np.abs(recording.q[:, 3]) < 1.0
    learnt, rng = recording.select(near), np.random.default_rng(1)
    group = unmodelled.group(Covariates(learnt), "A4", "q4")
    group = replace(group, coefficients=group.sigma * rng.standard_normal(group.k))
    model = EffectModel(recording.cell.robot, (group,), LearntRecording.of(learnt))

    far = replace(recording.select(near), pose_id=learnt.pose_id + 1000, q=learnt.q + np.array([0, 0, 0, np.pi, 0, 0]))
    away = np.abs((far.q[:, 3, None] - learnt.q[:, 3] + np.pi) % (2 * np.pi) - np.pi).min(axis=1) - np.radians(
        5
    )  # rad, to the nearest pose
    share = np.exp(-0.5 * (away / np.radians(70)) ** 2)
    going_on = evaluated(Covariates(far), group.parts)[0].basis @ group.coefficients

    np.testing.assert_allclose(model.displacements(far).joint[:, 3], share * going_on, rtol=1e-9)
    assert not model.left_out_at(learnt)
    (prior,) = model.left_out_at(far)
    spread = np.sqrt(np.sum((prior.parts[0].basis[:, : group.k] * prior.sigma) ** 2, axis=1))
    whole = np.sqrt(np.sum(group.sigma**2) / 2)  # of sines and cosines of every order
    np.testing.assert_allclose(spread, np.sqrt(1 - share**2) * whole, rtol=1e-6)


def test_elasticity_does_not_end_where_the_loads_did(recording):
    group = unmodelled.group(Covariates(recording), "A2", "gravity_torque_2")
    assert not group.fades


def test_leaving_the_learnt_range_is_said(recording, fitted):
    beyond = replace(recording, q=recording.q + np.array([0, 0, 0, 2.5, 0, 0]))
    said = " ".join(str(d) for d in fitted.effects.departures(beyond))
    assert "q4 leaves the range" in said
    (first,) = [d for d in fitted.effects.departures(beyond) if d.covariate == "q4"]
    assert first.poses == tuple(beyond.pose_id[first_left(fitted, beyond)])
    assert f"(numbers {first.poses[0]}, " in str(first)
    assert not fitted.effects.departures(recording)


def gear_of_joint_four(plan, degrees):
    """Context and candidate of a periodic error of A4, which moves over this range."""
    q = plan.q.copy()
    q[:, 3] = np.radians(np.linspace(*degrees, plan.n_poses))
    obs = replace(plan, q=q)
    state = simulated.nominal_state(obs)
    here = Context(obs, state, forward_model.predict(obs, state))
    every = catalogue.candidates(here)[0]
    return here, next(c for c in every if c.name == "gear_transmission_error" and c.where == ("A4",))


def test_no_order_is_claimed_of_which_the_travel_shows_less_than_a_period(plan):
    """Order 4 over 23 deg is a quarter of a period; 1, 2 and the gear's own over 100 deg are known by construction, from half of one on."""
    _, narrow = gear_of_joint_four(plan, (0, 23))
    _, wide = gear_of_joint_four(plan, (-50, 50))

    assert narrow.hyper.values.min() == pytest.approx(360 / 23)
    assert sorted(v for v in wide.hyper.values if v < 3.7) == [2.0, 3.0, pytest.approx(3.6)]
    assert wide.hyper.preferred == (2.0, 3.0, 4.0, 80.0, 160.0)


def test_an_error_of_less_than_a_period_holds_where_the_angle_was(plan):
    here, gear = gear_of_joint_four(plan, (-50, 50))

    assert partly_covered(here, gear, 2.0) == ("q4",)
    assert partly_covered(here, gear, 4.0) == ()
