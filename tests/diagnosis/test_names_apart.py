"""Which name it is, how often chance is taken for one, and which names stand up to data left out."""

from dataclasses import replace

import made
import numpy as np
import pytest
from scipy.stats import chi2

from mbcacq.diagnosis import diagnose, model_fit, noise_consistent_ranking, outlier_readmission, verdict
from mbcacq.diagnosis.linearized.variance_components import estimate
from mbcacq.diagnosis.nonparametric import model_comparison
from mbcacq.diagnosis.nonparametric.joint_model import columns_of
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.diagnosis.validation import cross_validation
from mbcacq.effects.pose import steps
from mbcacq.estimation.forward_model import Displacements


@pytest.mark.parametrize("k", [1, 6])
@pytest.mark.parametrize("level", [0.05, 0.005])
def test_a_moment_is_sought_among_as_many_independent_ones_as_are_counted(plan, k, level):
    """White noise cut in two at every moment: the best cut passes the threshold as seldom as is said, and not much more seldom."""
    setup = model_fit.prepare(plan)
    hyper = steps.moment(setup.context)
    n, rng = plan.n_poses, np.random.default_rng(5)
    first = np.arange(n)[None] >= hyper.values[:, None]
    column = first - first.mean(axis=1, keepdims=True)
    column /= np.linalg.norm(column, axis=1, keepdims=True)
    best = np.array([np.max(np.sum((column @ rng.normal(size=(n, k))) ** 2, axis=1)) for _ in range(4000)])

    rate = np.mean(best > chi2.isf(level / hyper.independent, k))

    assert 0.25 * level < rate < 1.3 * level


def test_a_slipping_bracket_is_not_told_as_a_warming_scanner(plan):
    """Both change slowly with time; of six components, one step explains more than three that fade."""
    observed = made.observe(plan, 131, [("mount_shift", ("mount",), [0.009, 0.006, -0.0075, 4.5e-5, -3e-5, 1.5e-5], 60.0)])

    assert model_fit.fit_model(model_fit.prepare(observed)).model.names == ("mount_shift",)


def test_what_a_ball_may_be_called_is_not_left_without_a_name(plan):
    observed = made.observe(plan, 132, [("ball_shift", ("ball3",), [0.004, -0.002, 0.003], None)])

    found = model_fit.fit_model(model_fit.prepare(observed))

    assert found.model.names == ("ball_shift",)
    assert found.smooth is None


def test_an_effect_that_hides_in_the_noise_gets_a_second_look(plan):
    """Lost motion makes its joint look like one that repeats badly: under that noise it is not significant, under a noise half as wrong it is."""
    observed = made.observe(plan, 139, [("backlash", ("A1",), [6e-6], None)])
    setup = model_fit.prepare(observed)
    sigma = estimate(setup.linear, *columns_of(setup.linear, NO_EFFECTS, None), setup.prior_noise, setup.prior_noise)
    search = BeamSearch(setup.candidates)

    looked = noise_consistent_ranking.reconsider_near_misses(search, setup.linear, sigma, setup.prior_noise)

    candidate = next(c for c in setup.candidates if c.name == "backlash" and c.depends_on == "direction_1")
    plain = CandidateScoring.of(setup.linear, sigma).test(candidate)
    assert [c.key for c, _ in looked.effects] == [candidate.key]
    assert looked.gain > 1.02 * plain.gain


def test_a_name_that_predicts_nothing_beside_a_true_one_is_taken_back(plan):
    observed = made.observe(plan, 133, [("joint_compliance", ("A2",), [2.5e-6], None)])
    setup = model_fit.prepare(observed)
    full = model_fit.fit_model(setup)
    false = next(c for c in setup.candidates if c.name == "joint_scale" and c.where == ("A6",))
    search = BeamSearch(setup.candidates)
    claimed = replace(full, model=search.solved(full.geometry_only, (*full.model.effects, (false, None))))

    proof = cross_validation.cross_validate(setup, claimed)
    told = verdict.conclude(setup, claimed, proof)

    assert proof.not_predictive == ("joint_scale",)
    assert [e.name for e in told.effects] == ["joint_compliance"]


def test_a_joint_that_predicts_nothing_beside_another_is_taken_back(plan):
    """One joint of a name may be true while a second, found beside it, is chance."""
    observed = made.observe(plan, 165, [("gear_transmission_error", ("A2",), [3e-5, 2e-5], 1.0)])
    setup = model_fit.prepare(observed)
    full = model_fit.fit_model(setup)
    false = next(c for c in setup.candidates if c.name == "gear_transmission_error" and c.where == ("A6",))
    search = BeamSearch(setup.candidates)
    claimed = replace(full, model=search.solved(full.geometry_only, (*full.model.effects, (false, 3.0))))

    proof = cross_validation.cross_validate(setup, claimed)
    told = verdict.conclude(setup, claimed, proof)

    assert proof.not_predictive == ("gear_transmission_error:A6",)
    assert [(e.name, e.where) for e in told.effects] == [("gear_transmission_error", ("A2",))]


def test_what_is_plain_but_predicts_nothing_is_not_passed_over(plan):
    """A ball that comes loose lies elsewhere at every station: no other station knows where, but it is no noise."""

    def loose(s):
        ball = np.zeros(s.obs.xyz.shape)
        lies = np.random.default_rng(6).normal(0, 0.02, (len(s.obs.cell.stations), 3))
        mine = s.obs.ball == 2
        ball[mine] = lies[s.obs.station[s.obs.pose[mine]]]
        return Displacements(ball=ball)

    told = diagnose.diagnose(made.observe(plan, 166, [loose]))

    assert told.verdict == "unexplained"
    assert told.mismatch[0].at == "ball3"
    assert [(e.name, e.where) for e in told.effects] == [("unknown", ("ball3",))]


def test_in_a_fold_it_is_asked_which_name_not_whether_there_is_one(plan):
    """What the whole recording shows weakly, half of it does not show by itself; which it is, it tells."""
    setup = model_fit.prepare(made.observe(plan, 178, [("joint_scale", ("A5",), [3e-5], None)]))
    full = model_fit.fit_model(setup)
    half = setup.linear.keep & (setup.linear.obs.pose % 2 == 1)

    alone, known = model_fit.fit_model(setup, half), model_fit.fit_model(setup, half, name_expected=True)

    assert 0 < full.model.penalised_gain < verdict.WEAK
    assert full.model.names == known.model.names == ("joint_scale",)
    assert alone.model.names == ()


def test_one_thing_without_a_name_is_not_strung_together_of_many(plan):
    def twist(s):
        frame = np.zeros((s.obs.n_poses, s.n + 1, 6))
        moment = s.gravity_moment(2)[:, 0]
        frame[:, 2, 3] = 6e-4 * np.tanh(moment / (0.5 * moment.std()))
        return Displacements(frame=frame)

    two = [("joint_compliance", ("A2",), [2.5e-6], None), ("joint_scale", ("A5",), [3e-4], None)]
    for effects, strung in (([twist], True), (two, False)):
        setup = model_fit.prepare(made.observe(plan, 168, effects))
        screen = CandidateScoring.of(setup.linear, estimate(setup.linear, *columns_of(setup.linear, NO_EFFECTS, None), setup.prior_noise, setup.prior_noise))
        names = BeamSearch(setup.candidates, situation=setup.context).grow(screen)

        assert len(names.effects) > 1
        assert model_comparison.overshadowed(screen, setup.design_blocks, names) == strung


def test_a_creeping_tripod_is_judged_on_the_other_stations(plan):
    """None of them knows of it: left out itself, its station remains as bad as it was."""
    observed = made.observe(plan, 134, [("station_drift", ("station3",), [0.3, -0.25, 0.4], None)])

    told = diagnose.diagnose(observed)

    assert [(e.name, e.where) for e in told.effects] == [("station_drift", ("station3",))]
    assert told.fit.held_out.split == "station"
    assert told.fit.held_out.after_chi2_dof > 2.0
    assert told.verdict == "explained"


def test_a_moment_that_falls_among_poses_left_out_is_not_held_against_the_step(plan):
    """Without the station in which an encoder jumped nobody knows at which of its poses."""
    observed = made.observe(plan, 137, [("joint_step", ("A2",), [8e-4], 52.0)])

    told = diagnose.diagnose(observed)

    assert (plan.station == plan.station[52]).sum() > 4
    assert told.effects[0].parameters["A2.at_pose"].value == 52
    assert told.fit.held_out.split == "station"
    assert told.fit.held_out.after_chi2_dof < 1.2
    assert told.verdict == "explained"


def test_centres_set_aside_come_back_where_an_effect_explains_them(plan):
    """A wrist encoder that jumps by a degree near the end: four centres far from its axis look like accidents."""
    setup = model_fit.prepare(made.observe(plan, 135, [("joint_step", ("A6",), [2e-2], 110.0)]))

    back = outlier_readmission.readmitted(setup)

    assert np.sum(~setup.linear.keep) > 3
    assert np.all(back.linear.keep)
    assert [c.key for c, _ in model_fit.fit_model(back).model.effects] == ["joint_step:A6:pose:"]


def test_a_ball_far_off_keeps_its_name(plan):
    """However far: a name is not given up for its size while nothing else fits better."""
    observed = made.observe(plan, 135, [("ball_shift", ("ball5",), [1.5, -1.0, 1.0], None)])

    told = diagnose.diagnose(observed)

    assert [(e.name, e.where) for e in told.effects] == [("ball_shift", ("ball5",))]
    assert told.verdict == "explained"


def test_two_scales_that_one_artefact_cannot_separate_are_both_said():
    observed = made.observe(made.plan(bars=0), 136, [("scanner_scale", ("scanner",), [540.0], None)])

    told = diagnose.diagnose(observed)

    named = {told.effects[0].name, *(a.name for a in told.effects[0].alternatives)}
    assert told.verdict == "cannot_tell"
    assert {"scanner_scale", "artefact_expansion"} <= named
