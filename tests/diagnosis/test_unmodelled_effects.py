"""An unmodelled effect is located where it acts, without wrong parametric effects, and predicts poses left out."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.calibration.calibrate import calibrate_with_effects
from mbcacq.calibration.transfer import check_transfer
from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.evidence.hypothesis import SetPrior, estimated
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.evidence.pose_search import PoseSearch
from mbcacq.diagnosis.evidence.unmodelled import UnmodelledEffects
from mbcacq.diagnosis.executor import WorkerPool
from mbcacq.diagnosis.nonparametric import basis_functions
from mbcacq.diagnosis.nonparametric.gaussian_process import Process
from mbcacq.diagnosis.output.kept_model import kept_model, term_of, unmodelled_terms
from mbcacq.diagnosis.output.over_whole_range import over_whole_range
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.bayes_factor import log_bayes_factors
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.diagnosis.validation.cross_validation import validated
from mbcacq.diagnosis.validation.folds import repeated
from mbcacq.diagnosis.verdict import conclude, verdict_of
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import parts_of
from mbcacq.effects.effect_term import SMOOTH, LearntRecording
from mbcacq.effects.functions import DescribedPart, evaluate, of, sine
from mbcacq.effects.learnt_range import learnt_ranges
from mbcacq.estimation.forward_model import Displacements
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.variance_components import pack


def test_a_bayes_factor_of_a_hundred_is_rare_without_an_effect():
    rng = np.random.default_rng(5)
    columns = rng.normal(size=(200, 4))
    columns /= np.linalg.norm(columns, axis=0)
    b = rng.normal(size=(20000, 200)) @ columns

    log = log_bayes_factors(np.tile(columns.T @ columns, (20000, 1, 1)), b)

    assert np.mean(log > np.log(100)) <= 0.01
    assert np.mean(log > np.log(10)) <= 0.1


def wobble_across_joint_two(s):
    """Three lobes a turn, across the axis of joint 2: no error of any joint's angle."""
    frame = np.zeros((s.obs.n_poses, s.n + 1, 6))
    frame[:, 2, 3], frame[:, 2, 4] = 3e-4 * np.sin(3 * s.obs.q[:, 1]), 3e-4 * np.cos(3 * s.obs.q[:, 1])
    return Displacements(frame=frame)


def twist_of_link_two_that_saturates(s):
    """About the link's own length (its x), under the moment about it."""
    moment = s.gravity_moment(2)[:, 0]
    frame = np.zeros((s.obs.n_poses, s.n + 1, 6))
    frame[:, 2, 3] = 6e-4 * np.tanh(moment / (2 * moment.std()))
    return Displacements(frame=frame)


def hose_that_pulls_joint_five(s):
    joint = np.zeros(s.obs.q.shape)
    joint[:, 4] = 8e-4 * np.tanh(np.abs(s.obs.q[:, 5] - 0.2) / 0.3) ** 2
    return Displacements(joint=joint)


def bearing_that_sinks_in_where_it_is_damaged(s):
    """The frame behind link 3 tilts while its lower side is at some angle of the ring, whatever hangs behind it."""
    down = np.einsum("pji,j->pi", s.nominal_frames[:, 3, :3, :3], s.obs.cell.robot.gravity)
    angle = np.arctan2(down[:, 1], down[:, 0])
    about_mean = np.angle(np.exp(1j * angle) / np.exp(1j * angle).mean())
    frame = np.zeros((s.obs.n_poses, s.n + 1, 6))
    frame[:, 3, 3] = 8e-4 * np.exp(-0.5 * ((about_mean - np.median(about_mean)) / 0.2) ** 2)
    return Displacements(frame=frame)


def test_a_damaged_bearing_is_described_by_which_way_is_down():
    observed = simulated.observe(simulated.plan(8, 2, 6), 120, [bearing_that_sinks_in_where_it_is_damaged])
    first = model_fit.fit_model(prepare(observed)).evidence.best.members[0].candidate
    assert first.where == ("link3",)
    assert first.variant.startswith("process of gravity_direction_3")


def test_a_wobbling_axis_is_located_in_the_link_behind_it(plan):
    found = model_fit.fit_model(prepare(simulated.observe(plan, 120, [wobble_across_joint_two])))

    assert verdict_of(found) == "unexplained"
    assert (found.cells[0].location, found.cells[0].depends_on) == ("link2", "q2")
    assert found.model.members == ()


def test_a_twisting_link_is_located_and_predicts_what_was_left_out(plan):
    setup = prepare(simulated.observe(plan, 121, [twist_of_link_two_that_saturates]))
    full = model_fit.fit_model(setup)
    reported = conclude(setup, full, validated(full, repeated(setup, full, 2, WorkerPool())[0]))

    assert reported.verdict == "unexplained"
    assert reported.mismatch[0].at == "link2"
    assert reported.mismatch[0].depends_on.startswith("gravity_torque")
    assert [e.name for e in reported.effects] == ["unknown"]
    assert reported.effects[0].held_out_gain > 0.9


def test_a_pulling_hose_is_not_reported_as_a_wrist_coupling(medium_plan):
    found = model_fit.fit_model(prepare(simulated.observe(medium_plan, 122, [hose_that_pulls_joint_five])))

    assert "wrist_coupling" not in found.model.names
    assert (found.cells[0].location, found.cells[0].depends_on) == ("A5", "q6")


def pull_on_joint_five_where_five_and_six_meet(s):
    """A bump over two angles: at either of them it may be there or not."""
    away = s.obs.q[:, 4:6] - np.median(s.obs.q[:, 4:6], axis=0)
    joint = np.zeros(s.obs.q.shape)
    joint[:, 4] = 1e-3 * np.exp(-0.5 * np.sum((away / 0.7) ** 2, axis=1))
    return Displacements(joint=joint)


def test_an_effect_of_two_angles_is_predicted_better_by_a_process_of_both_than_by_functions_of_one(medium_plan, monkeypatch):
    def squares_removed():
        setup = prepare(simulated.observe(medium_plan, 125, [pull_on_joint_five_where_five_and_six_meet]))
        found = model_fit.fit_model(setup)
        assert found.model.members == ()
        assert found.cells[0].location == "A5"
        scores = validated(found, repeated(setup, found, 3, WorkerPool())[0])
        return 1 - scores.after.square / scores.before.square

    of_both = squares_removed()
    monkeypatch.setattr(UnmodelledEffects, "process", lambda *_: None)
    monkeypatch.setattr(basis_functions, "pairs", lambda *_: [])
    of_one = squares_removed()

    assert of_both > 0.85
    assert of_one < 0.7


def test_what_a_process_describes_is_kept_for_other_places(medium_plan):
    observed = simulated.observe(medium_plan, 125, [pull_on_joint_five_where_five_and_six_meet])
    elsewhere = np.isin(observed.station, np.unique(observed.station)[::3])
    learnt_from = observed.select(~elsewhere)

    model = kept_model(model_fit.fit_model(prepare(learnt_from)))
    fitted = calibrate_with_effects(learnt_from, CalibrationOptions(refuse=False), model)
    check = check_transfer(observed.select(elsewhere), fitted)

    assert fitted.effects is not None
    (kept,) = [t for t in fitted.effects.terms if t.variant.startswith("process")]
    assert kept.where == ("A5",)
    assert set(kept.clamped) == kept.covariates == {"q5", "q6"}
    assert np.all(learnt_from.q[:, 5].min() < 0 < learnt_from.q[:, 5].max())
    here = Covariates(learnt_from)
    (part,) = kept.parts_at(here, fitted.effects.learnt)
    np.testing.assert_allclose(part.basis, evaluate(kept.parts[0].columns, here.value, learnt_from.n_poses))
    assert check.with_effects.rms_mm < 0.5 * check.geometry_alone.rms_mm


def test_what_is_kept_displaces_what_was_judged():
    """Blocks of several locations and a process of two angles, on joints that turn to both sides of their zero."""
    setup = prepare(simulated.observe(simulated.plan(6, 2, 6), 125, [pull_on_joint_five_where_five_and_six_meet]))
    blocks, obs = UnmodelledEffects(setup.design_blocks), setup.linear.obs
    point = NoisePoint(setup.linear, setup.prior_noise, pack(setup.noise))
    judged = [m for _, m in blocks.evidence(point.projected)]
    process = blocks.process(point.projected, next(m for m in judged if m.candidate.where == ("A5",)))
    found = estimated((*judged, process), point, 0.0)

    here, learnt = Covariates(obs), LearntRecording.of(obs)
    assert process.candidate.depends_on in ("q5", "q6")
    assert np.all(obs.q[:, 4:].min(axis=0) < 0)
    kept = [term.parts_at(here, learnt) for term in unmodelled_terms(here, found) if term.variant != SMOOTH]  # the others go on elsewhere
    for member in found.members:
        k, judged = member.candidate.k, parts_of(member.candidate, here)
        term = term_of(here, member.candidate, member.hyper, np.zeros(k), np.ones(k))
        if over_whole_range(here, term)[0] is term:
            for part, own in zip(kept.pop(0), judged, strict=True):
                np.testing.assert_allclose(part.basis, own.basis, atol=1e-8 * np.abs(own.basis).max())
    assert kept == []


@pytest.mark.parametrize(("function", "known"), [(sine("q1", 2.0), True), (of("q1", "cosine", -3.0, 3.0, 2.0), False)])
def test_another_turn_is_the_same_place_to_what_repeats_alone(plan, function, known):
    """A hose that was wound up by half a turn says nothing of a turn and a half, a gear error of two periods a turn does."""
    observed = simulated.observe(plan, 125, [])
    q = observed.q.copy()
    q[:, 0] = np.linspace(-2.0, 2.0, len(q))
    covariates = Covariates(replace(observed, q=q))
    learnt = learnt_ranges(covariates, [DescribedPart("joint", 4, 0, (function,))])["q1"]
    assert not learnt.outside("q1", q[:, 0]).any()
    assert learnt.outside("q1", np.array([1.0 + 2 * np.pi]))[0] == (not known)
    assert learnt.outside("q1", np.array([3.0]))[0]


def test_a_process_is_tried_where_its_functions_can_stand_for_it():
    """Over 52 lengths of one angle and 17 of another, ninety functions carry two fifths of the prior variance."""

    def process(length, q6):
        return Process("q5", (("q5", -1.7, 1.7), ("q6", -q6, q6)), length, 1.0)

    assert not process(0.2, 5.2).is_represented
    assert process(0.8, 5.2).is_represented
    assert process(0.4, 1.7).is_represented


def search_of(setup):
    """The search of a recording, its blocks, and the point at which it begins."""
    blocks = UnmodelledEffects(setup.design_blocks)
    prior = SetPrior.of(setup.candidates, len(blocks.design_blocks.locations))
    search = PoseSearch(candidates=setup.candidates, unmodelled=blocks, prior=prior, context=setup.context)
    return search, blocks, NoisePoint(setup.linear, setup.prior_noise, pack(setup.noise))


@pytest.mark.parametrize("covariate", ["gravity_torque", "q2"])
def test_elastic_joints_are_better_together_than_a_general_function_of_the_load_or_of_an_angle(plan, covariate):
    def elastic(s):
        return Displacements(joint=s.gravity_torque * np.array([0, 3e-6, 4e-6, 0, 9e-6, 0]))

    search, blocks, point = search_of(prepare(simulated.observe(plan, 126, [elastic])))
    general = next(m for _, m in blocks.evidence(point.projected) if m.candidate.depends_on.startswith(covariate))
    best = estimated((general,), point, search.log_prior((general,)))

    found = search.with_common_effects(best)

    assert {"joint_compliance:A2", "joint_compliance:A3"} <= found.labels
    assert not found.unmodelled
    assert found.log_posterior > best.log_posterior + 10


def test_a_general_function_of_the_covariate_of_a_name_stands_beside_it():
    """An error of A3 by its own angle that is no sine: the name stays, and what its lines leave is unmodelled there."""

    def notched(s):
        joint = np.zeros(s.obs.q.shape)
        joint[:, 2] = 8e-4 * np.exp(-0.5 * ((s.obs.q[:, 2] - np.median(s.obs.q[:, 2])) / 0.1) ** 2)
        return Displacements(joint=joint)

    setup = prepare(simulated.observe(simulated.plan(8, 3, 6), 127, [notched]))
    search, _, point = search_of(setup)
    gear = next(c for c in setup.candidates if c.name == "gear_transmission_error" and c.where == ("A3",))
    members = (Member(gear, float(gear.hyper.values[4])),)
    best = estimated(members, point, search.log_prior(members))

    search.compare_general_forms(best)

    general = [h for h in search.known.values() if h.unmodelled]
    assert general
    assert all(h.labels == {"gear_transmission_error:A3", "unknown:A3"} for h in general)


def test_a_name_that_mends_a_shape_is_left_out_for_a_more_general_shape():
    """The bump over two angles as functions of one of them, and a step of the mount in time that follows the rest of it by chance."""
    setup = prepare(simulated.observe(simulated.plan(6, 2, 6), 125, [pull_on_joint_five_where_five_and_six_meet]))
    search, blocks, point = search_of(setup)
    shift = next(c for c in setup.candidates if c.name == "mount_shift")
    plain = next(m for _, m in blocks.evidence(point.projected) if m.candidate.where == ("A5",))
    mended = (plain, Member(shift, float(shift.hyper.values[20])))
    best = estimated(mended, point, search.log_prior(mended))

    search.generalise(best)

    (general,) = search.known.values()
    assert general.labels == {"unknown:A5"}
    assert general.members[0].candidate.variant.startswith("process")
    assert general.log_posterior > best.log_posterior


def test_cosines_on_a_box_are_a_process_with_a_matern_kernel():
    """Away from the walls the covariance of the random effect is the kernel, but for a constant, which is no effect."""
    length, x = 0.4, np.linspace(-1.0, 1.0, 9)
    grid = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    process = Process("q1", (("q1", -3.0, 3.0), ("q2", -3.0, 3.0)), length, 1.0)

    columns, sigma = process.functions(10**6)
    F = evaluate(columns, lambda name: grid[:, ["q1", "q2"].index(name)], len(grid)) * sigma
    # A cosine of order zero in one covariate is constant there: of twice the mean square.
    constant = np.array([sum(2 - len(p.functions) for p in column) for column in columns])
    covariance = (F * 0.5**constant) @ F.T

    away = np.sqrt(5) * np.linalg.norm(grid[:, None] - grid, axis=2) / length
    kernel = (1 + away + away**2 / 3) * np.exp(-away)
    regressors = np.stack([covariance.ravel(), np.ones(covariance.size)], axis=1)
    scaled = regressors @ np.linalg.lstsq(regressors, kernel.ravel())[0]
    assert np.abs(scaled - kernel.ravel()).max() < 0.01


def test_two_effects_that_cancel_each_other_are_not_reported_together():
    """With one artefact alone a scanner's scale and the artefact's can hardly be reported apart: never both, thousands of ppm against each other."""
    found = model_fit.fit_model(prepare(simulated.observe(simulated.plan(bars=0), 123, [("scanner_scale", ("scanner",), [300.0], None)])))

    assert len(set(found.model.names) & {"scanner_scale", "artefact_expansion"}) == 1
    assert abs(abs(found.model.coefficients[0]) - 300.0) < 100.0


def test_instrument_noise_stays_near_its_stated_value(plan):
    """A ball off by half a millimetre is no noise of an instrument of ten micrometres."""
    observed = simulated.observe(plan, 124, [("ball_shift", ("ball3",), [0.3, 0.2, -0.3], None)])

    found = model_fit.fit_model(prepare(observed))

    assert np.all(found.noise.point < 1.3 * simulated.POINT_NOISE)
    assert [m.candidate.name for m in found.model.members] == ["ball_shift"]


def test_patterns_that_differ_in_an_offset_alone_share_no_name_of_a_coefficient(plan):
    one, other = (unmodelled.common_pattern(Covariates(plan), [0.0, offset], [1, -1], [1, 3]) for offset in (0.3, 0.4))
    assert len({*one.names, *other.names}) == one.k + other.k
