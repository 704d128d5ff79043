"""The torque that passes a gear is known with an error, which is in the uncertainty of what it winds up and passes for no effect."""

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose_trajectories import recording, torque

from mbcacq.diagnosis.motion.channel_groups import channel_groups
from mbcacq.diagnosis.motion.diagnose import Recordings
from mbcacq.diagnosis.motion.effect_selection import EffectSelection
from mbcacq.diagnosis.motion.fit import fit_selected, with_load
from mbcacq.diagnosis.motion.load_error import load_error
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.signals import prepare

SOFT, SHAPE_NM = 2e-5, 1.0  # rad/(N m); size of the error of a load


def prepared(seed):
    trajectory = recording(seed, compliance=SOFT, load_share=0.0)
    signals, inertial = prepare(trajectory)
    return trajectory, signals, inertial


def true_load(signals):
    return torque(signals.smooth, signals.qd, signals.qdd)


def joint_side(runs, inertial, robot):
    (group,) = [g for g in channel_groups(runs, inertial, robot) if g.name == "q_joint"]
    selection = EffectSelection(MotionModel(group, runs))
    selection.run()
    return fit_selected(selection)


@pytest.fixture(scope="module")
def runs():
    return [prepared(seed) for seed in (1, 2)]


def with_wrong_load(runs, error_known):
    """The load of A2 with an error in the shape of its fifth harmonic; whether that shape is known to be possible."""
    out = []
    for _, signals, _ in runs:
        shape = SHAPE_NM * np.sin(5.0 * signals.smooth[:, 1])
        load, error = true_load(signals), np.zeros((len(shape), 2, 1))
        load[:, 1] += 1.5 * shape
        error[:, 1, 0] = shape
        out.append(replace(signals, load=load, load_error=error if error_known else np.zeros((len(shape), 2, 0))))
    return tuple(out)


@pytest.mark.parametrize("known", [True, False])
def test_an_error_of_the_load_is_an_effect_only_where_it_is_not_known_to_be_one(runs, known):
    fit = joint_side(with_wrong_load(runs, known), [inertial for *_, inertial in runs], runs[0][0].robot)
    names = {e.candidate.name for e in fit.effects}
    assert names == {"joint_compliance"} if known else names > {"joint_compliance"}
    if known:
        (compliance,) = [e.found.parameters["A2.compliance_rad_per_Nm"] for e in fit.effects if e.candidate.where == ("A2",)]
        assert abs(compliance.value - SOFT) < 3 * compliance.std


def test_the_stated_error_of_the_load_is_that_of_arms_whose_masses_and_offsets_are_drawn_from_their_prior(runs):
    """Mean square of both, over arms, in the noise of a drive."""
    trajectory, signals, inertial = runs[0]
    (group,) = [g for g in channel_groups((signals,), [inertial], trajectory.robot) if g.name == "tau"]
    rng, errors, stated = np.random.default_rng(3), [], []
    offset = np.array(MotionModel(group, (signals,)).store.prior[: len(group.joints)])
    for _ in range(60):
        true = rng.normal(size=group.base[0].shape[2])
        torque_error = group.base[0] @ true + offset * rng.normal(size=len(offset)) + rng.normal(0, 3.0, signals.q.shape)
        model = MotionModel(replace(group, mismatch=(torque_error,)), (signals,))
        chosen = model.chosen()
        weights = model.weights(chosen)
        found = model.store.solve(model.store.normal(weights), chosen)[len(offset) :]
        links = len(true) - signals.q.shape[1]  # the last are the rotors, which the gear does not pass on
        errors.append(np.mean((group.base[0][:, :, :links] @ (found - true)[:links]) ** 2))
        stated.append(np.mean(np.sum(load_error(model, weights)[0] ** 2, axis=2)))
    assert np.mean(errors) == pytest.approx(np.mean(stated), rel=0.35)


def test_a_load_whose_torque_is_not_explained_is_wrong_by_a_share_of_itself():
    fits = Recordings([recording(1, compliance=SOFT), recording(2, compliance=SOFT)]).explain()[0]
    torque_fit = next(fit for fit in fits if fit.group.name == "tau")
    unexplained = replace(torque_fit, train_after=1e3 * torque_fit.floor**2)
    signals = tuple(prepare(recording(seed, compliance=SOFT))[0] for seed in (1, 2))
    for run in with_load(signals, unexplained):
        assert np.allclose(np.sqrt(np.sum(run.load_error**2, axis=2)), 0.05 * np.abs(run.load))


def test_only_a_torque_has_an_error_of_the_load(runs):
    (group,) = [g for g in channel_groups(tuple(s for _, s, _ in runs), [i for *_, i in runs], runs[0][0].robot) if g.name == "q_joint"]
    model = MotionModel(group, tuple(s for _, s, _ in runs))
    assert all(one.shape[2] == 0 for one in load_error(model, np.ones(2)))
