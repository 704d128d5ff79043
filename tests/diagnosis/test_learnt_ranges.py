"""What was learnt has a range: beyond it a named effect is a constant, an unmodelled one is less and less known, and nothing gets worse."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import simulated

from mbcacq.calibration.calibrate import calibrate, calibrate_with_effects
from mbcacq.calibration.transfer import check_transfer
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.output.kept_model import term_of
from mbcacq.diagnosis.output.over_whole_range import with_open_laws_as_functions
from mbcacq.diagnosis.problem import prepare
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import evaluated
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import BEYOND, LearntRecording
from mbcacq.effects.learnt_range import LearntRange
from mbcacq.estimation.forward_model import Displacements
from mbcacq.estimation.options import CalibrationOptions

DEG = np.pi / 180


def eccentric_base_joint(s):
    """A disc of the encoder of A1 that sits off its axis: once a turn."""
    joint = np.zeros(s.obs.q.shape)
    joint[:, 0] = 8e-4 * np.sin(s.obs.q[:, 0] + 0.6)
    return Displacements(joint=joint)


def postures(seed: int, count: int, share: float) -> np.ndarray:
    """Evenly at random over a share of the range of each joint, about its middle."""
    low, high = simulated.robot().limits.T
    middle, half = (low + high) / 2, share * (high - low) / 2
    return np.random.default_rng(seed).uniform(middle - half, middle + half, (count, 6))


@pytest.fixture(scope="module")
def third():
    """A third of the ranges, and all of them, of one arm."""
    here, there = simulated.tracked(postures(1, 80, 1 / 3)), simulated.tracked(postures(2, 80, 1.0))
    here, there = (simulated.observe(obs, seed, [eccentric_base_joint], arm=5) for obs, seed in ((here, 11), (there, 12)))
    return here, replace(there, pose_id=there.pose_id + 1000)


@pytest.fixture(scope="module")
def learnt(third):
    here, _ = third
    options = CalibrationOptions(refuse=False)
    alone = calibrate(here, replace(options, discrepancy=False, random_links=False))
    return calibrate_with_effects(here, options, diagnose(here).model), alone


def test_what_looks_like_a_scale_over_a_third_does_no_harm_over_all(third, learnt):
    (cell, alone), (_, there) = learnt, third
    assert {"A1"} <= {at for t in cell.effects.terms for at in t.where}
    tried = check_transfer(there, cell, alone.state.chain)
    assert tried.with_effects.rms_mm < 1.05 * tried.geometry_alone.rms_mm
    assert 0 < tried.inside_centres < tried.centres
    squares = tried.inside.rms_mm**2 * tried.inside_centres + tried.outside.rms_mm**2 * (tried.centres - tried.inside_centres)
    assert squares == pytest.approx(tried.with_effects.rms_mm**2 * tried.centres)
    assert tried.inside_centres == int(cell.effects.inside(there).sum())
    assert "beyond that range" in tried.text


def beyond_the_edge(here, joint):
    """Postures at the upper edge of what a joint visited, and half a radian and one radian beyond it."""
    q = np.tile(here.q.mean(axis=0), (3, 1))
    q[:, joint] = here.q[:, joint].max() + np.array([0, 0.5, 1.0])
    return q


def test_beyond_the_angles_where_a_function_was_learnt_the_cell_returns_to_the_one_without_it(third, learnt):
    (here, _), (cell, _) = third, learnt
    without = calibrate(here, CalibrationOptions(refuse=False, discrepancy=False))
    going_on = replace(cell, effects=cell.effects.select(lambda t: t.variant != BEYOND))

    def apart(one, beyond):
        """(P, 3) mm from the target in the instrument of the cell without the function, at q1 beyond the visited angles."""
        q = here.q.copy()
        q[:, 0] = here.q[:, 0].max() + beyond if beyond else q[:, 0]
        at = [np.linalg.inv(c.state.T_base_station[0]) @ c.frames(q)[:, -1] @ c.state.T_flange_scanner for c in (one, without)]
        return (at[0] - at[1])[:, :3, 3]

    assert np.abs(apart(cell, 0.0)).max() > 0.1
    for beyond in (0.8, 2.0):
        share = np.exp(-0.5 * ((beyond - 5 * DEG) / (70 * DEG)) ** 2)
        np.testing.assert_allclose(apart(cell, beyond), share * apart(going_on, beyond), atol=0.01 * np.abs(apart(going_on, beyond)).max())


def test_an_unmodelled_function_is_ten_times_less_known_beyond_where_it_was_learnt(third, learnt):
    (here, _), (cell, _) = third, learnt
    q, read = beyond_the_edge(here, 0), EffectModel.from_dict(cell.effects.to_dict())
    np.testing.assert_array_equal(read.displacements(read.poses(q)).joint, cell.effects.displacements(read.poses(q)).joint)
    middle, point = np.tile(here.q.mean(axis=0), (3, 1)), np.tile([0.0, 0.0, 100.0], (3, 1))
    at_edge, near, far = np.linalg.norm(cell.distance_errors(middle, point, q, point)[1], axis=1)
    assert 10 * at_edge < min(near, far)


def test_a_named_effect_is_a_constant_beyond_its_range_and_a_file_keeps_that(third):
    here, _ = third
    gear = next(c for c in prepare(here).candidates if c.name == "gear_transmission_error" and c.where == ("A4",))
    term = term_of(Covariates(here), gear, 1.0, np.array([1e-4, 2e-4]), np.array([1e-6, 1e-6]))
    model = EffectModel(here.cell.robot, (term,), LearntRecording.of(here))
    for one in (model, EffectModel.from_dict(model.to_dict())):
        moved = one.displacements(one.poses(beyond_the_edge(here, 3))).joint[:, 3]
        assert moved[0] == pytest.approx(moved[1]) == pytest.approx(moved[2])
    assert not model.left_out_at(here)
    far = replace(here, pose_id=here.pose_id + 1000, q=here.q + np.array([0, 0, 0, 1.5, 0, 0]))
    (beyond,) = model.left_out_at(far)
    moved = far.q[:, 3] > here.q[:, 3].max() + 0.2
    assert np.all(np.abs(beyond.parts[0].basis[moved] * beyond.sigma).sum(axis=1) > 0)  # what is not known there has a variance


def test_a_period_that_was_seen_goes_on_and_less_of_one_does_not(third):
    here, there = third
    for obs, order, held in ((here, 1.0, ("q4",)), (here, 8.0, ()), (there, 1.0, ())):
        gear = next(c for c in prepare(obs).candidates if c.name == "gear_transmission_error" and c.where == ("A4",))
        assert term_of(Covariates(obs), gear, order, np.ones(2), np.ones(2)).clamped == held


def test_a_gear_winds_up_in_proportion_to_loads_beyond_the_recorded_ones_with_an_uncertainty_of_its_own(third):
    here, there = third
    soft = next(c for c in prepare(here).candidates if c.name == "joint_compliance" and c.where == ("A2",))
    term = term_of(Covariates(here), soft, None, np.array([1e-6]), np.array([1e-8]))
    model = EffectModel(here.cell.robot, (term,), LearntRecording.of(here))
    seen, loads = Covariates(here).gravity_torque[:, 1], Covariates(there).gravity_torque[:, 1]
    np.testing.assert_allclose(model.displacements(there).joint[:, 1], 1e-6 * loads, rtol=1e-12)
    (beyond,) = model.left_out_at(there)
    further = 1e-6 * np.abs(loads - np.clip(loads, seen.min(), seen.max()))
    np.testing.assert_allclose(np.abs(beyond.parts[0].basis[:, 0] * beyond.sigma), 0.3 * further, rtol=1e-3, atol=1e-15)
    unnamed_one = replace(soft, name="unknown")
    held = term_of(Covariates(here), unnamed_one, None, np.array([1e-6]), np.array([1e-8]))
    moved = replace(model, terms=(held,)).displacements(there).joint[:, 1]
    np.testing.assert_allclose(moved, 1e-6 * np.clip(loads, seen.min(), seen.max()), rtol=1e-12)


def test_the_spring_of_a_balancer_pulls_by_its_levers_wherever_the_arm_is(third):
    here, there = third
    spring = next(c for c in prepare(here).candidates if c.name == "gravity_compensator")
    term = term_of(Covariates(here), spring, 0.15, np.array([1e-3, -2e-3, 1e-4]), np.full(3, 1e-5))
    model = EffectModel(here.cell.robot, (term,), LearntRecording.of(here))
    (everywhere,) = evaluated(Covariates(there), term.parts)
    np.testing.assert_allclose(model.displacements(there).joint[:, 1], everywhere.basis @ term.coefficients, atol=1e-15)
    (beyond,) = model.left_out_at(there)
    outside = term.ranges["q2"].outside("q2", there.q[:, 1])
    stated = np.linalg.norm(beyond.parts[0].basis * beyond.sigma, axis=1)
    assert stated[~outside].max() < stated[outside].min()


@pytest.mark.parametrize(("log_odds", "goes_on"), [(-1.0, False), (-5.0, True)])
def test_a_balancer_that_a_function_without_a_name_may_replace_has_no_law_elsewhere(third, log_odds, goes_on):
    here, _ = third
    spring = next(c for c in prepare(here).candidates if c.name == "gravity_compensator")
    kept = EffectModel(here.cell.robot, (term_of(Covariates(here), spring, 0.15, np.array([1e-3, 0.0, 0.0]), np.full(3, 1e-5)),))
    named, general = (SimpleNamespace(labels={f"{name}:A2"}, members=()) for name in ("gravity_compensator", "unknown"))
    named.log_posterior, general.log_posterior = 0.0, log_odds
    fit = SimpleNamespace(best=named, hypotheses=(named, general))
    terms = with_open_laws_as_functions(here, kept, fit).terms
    assert {t.name for t in terms} == ({"gravity_compensator"} if goes_on else {"unknown"})
    assert {t.depends_on for t in terms} == {"q2"}


@pytest.mark.parametrize(
    ("visited", "at", "held"),
    [
        ((-60, 60), (0, 59, 80, 170, -170, -80), (0, 59, 60, 60, -60, -60)),
        ((150, 210), (180, -160, 215, 140), (180, -160, 210, 150)),
        ((-180, 175), (0, 177.6, 179), (0, 177.6, 179)),  # a whole turn
    ],
)
def test_an_angle_that_repeats_is_held_at_the_nearer_end_of_what_was_not_visited(visited, at, held):
    known = LearntRange.of("q1", np.radians(np.arange(*visited, 2.0).tolist() + [visited[1]]), counts_turns=False)
    np.testing.assert_allclose(known.held("q1", np.radians(at)), np.radians(held), atol=1e-12)


def test_an_angle_that_counts_turns_is_held_at_its_own_ends():
    known = LearntRange.of("q1", np.radians([-10.0, 0.0, 200.0]), counts_turns=True)
    np.testing.assert_allclose(known.held("q1", np.radians([-370.0, 100.0, 220.0])), np.radians([-10.0, 100.0, 200.0]))
