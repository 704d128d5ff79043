"""Effects of motion are selected by the evidence of sets: the marginal likelihood of all samples, as for poses."""

import json

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from test_diagnose_trajectories import recording

from mbcacq.diagnosis.motion import diagnose
from mbcacq.diagnosis.motion.channel_groups import channel_groups
from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories
from mbcacq.diagnosis.motion.effect_search import sized, that_show
from mbcacq.diagnosis.motion.effect_selection import EffectSelection
from mbcacq.diagnosis.motion.gram_point import GramPoint, GramProblem
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.diagnosis.search.bayes_factor import log_set_bayes_factor


def torque_model(*trajectories):
    recordings = diagnose.Recordings(trajectories)
    group = channel_groups(recordings.runs, recordings.inertial, recordings.robot)[0]
    return MotionModel(group, recordings.runs)


def test_the_evidence_from_gram_matrices_is_that_of_all_samples():
    """Friction of A2 against none, at one noise and one size, by normal densities of the samples of both torques themselves."""
    run = recording(1, coulomb=1.0)
    short = type(run)(run.robot, run.time_s[:600], run.q[:600], torque=run.torque[:600])
    model = torque_model(short)
    selection = EffectSelection(model)
    store, sigma, size = model.store, np.array([0.3, 0.35]), 3.0
    problem = GramProblem.of(model, np.ones(2))
    information = np.diag(problem.weighted(sigma**-2.0, corrected=True))[:-1]
    (friction,) = (v[0] for v in selection.pool.forms if v[0].candidate.location == ("friction", ("A2",)))
    member = sized(friction, np.array(store.prior), information)
    point = GramPoint(problem, 2.0 * np.log(sigma))
    system = point.with_effects(point.extended([member]))
    found, _ = log_set_bayes_factor(system.A, system.a, [slice(0, 2)], [np.array([size])], [False])

    def columns(j, ids):
        out = np.zeros((len(store.matrix[j]), len(ids)))
        for i, column in enumerate(ids):
            out[:, i] = store.matrix[j][:, store.numbers[j] == column].sum(axis=1)
        return out[store.present(j) > 0]

    base = np.concatenate([columns(j, store.base) for j in (0, 1)]) * np.array(store.prior)[store.base]
    effect = np.concatenate([columns(j, friction.columns) for j in (0, 1)]) * member.candidate.typical * size
    mismatch = np.concatenate([store.matrix[j][store.present(j) > 0, 0] for j in (0, 1)])
    noise = np.concatenate([np.full(int(store.present(j).sum()), sigma[j] ** 2) for j in (0, 1)])
    without = np.diag(noise) + base @ base.T
    with_it = without + effect @ effect.T
    true = [multivariate_normal(cov=cov).logpdf(mismatch) for cov in (with_it, without)]
    assert found == pytest.approx(true[0] - true[1], rel=1e-6)
    assert found > 10.0


def test_what_changes_no_sample_has_no_size_and_is_not_compared():
    model = torque_model(recording(1))
    forms = next(tuple(v) for v in EffectSelection(model).pool.forms if len(v) > 1)
    information = np.ones(len(model.store.prior))
    information[forms[0].columns] = 0.0
    assert that_show(forms, information) == forms[1:]
    information[:] = 0.0
    assert that_show(forms, information) == ()


def test_an_arm_without_effects_has_an_e_value_below_the_threshold():
    found = diagnose_trajectories([recording(1), recording(2)], cross_validation=False)
    assert [e.channel for e in found.evidence] == ["tau", "q_joint"]
    assert not any(e.evidence.significant for e in found.evidence)
    assert all(e.evidence.log_e_value < 0.0 for e in found.evidence)


def test_a_set_without_the_delay_explains_the_recording_as_it_was_recorded():
    """The correction of the delay leaves nothing that the column of the delay could explain; what it corrected shows it."""
    found = diagnose_trajectories([recording(k, latency=0.003) for k in (1, 2)], cross_validation=False)
    evidence = {e.channel: e.evidence for e in found.evidence}["q_joint"]
    assert evidence.significant
    late = [s for s in evidence.sets if any(e.name == "channel_latency" for e in s.effects)]
    others = [s for s in evidence.sets if s not in late]
    assert late[0].log_odds == 0.0
    assert all(s.log_odds < -1000.0 for s in others)
    (effect,) = (e for e in found.named_effects if e.name == "channel_latency")
    assert effect.p_value < 1e-100


def test_the_evidence_stands_in_the_json():
    found = diagnose_trajectories([recording(1, coulomb=5.0), recording(2, coulomb=5.0)], cross_validation=False)
    again = MotionDiagnosis.from_json(json.loads(json.dumps(found.to_json(), allow_nan=False)))
    assert again.evidence == found.evidence
    best = found.evidence[0].evidence.sets[0]
    assert {(e.name, e.where) for e in best.effects} == {("friction", ("A1",)), ("friction", ("A2",))}
    assert all(abs(e.parameters[f"{e.where[0]}.coulomb_Nm"].value - 5.0) < 0.1 for e in best.effects)
