"""Calibration and diagnosis are two questions asked of one adjustment."""

import dataclasses

import numpy as np
import pytest
import simulated

from mbcacq.calibration.calibrate import calibrate
from mbcacq.diagnosis.model_fit import fit_model
from mbcacq.diagnosis.problem import prepare
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.recording import load_observations


def assert_same_cell(observations):
    calibrated = calibrate(observations, CalibrationOptions(refuse=False, discrepancy=False, random_links=False))
    problem = prepare(observations)
    state = problem.linear.state

    np.testing.assert_array_equal(problem.linear.obs.pose_id, calibrated.fit.observations.pose_id)
    for name in ("point", "joint"):
        np.testing.assert_array_equal(getattr(problem.noise, name), getattr(calibrated.noise, name))
    np.testing.assert_array_equal(state.chain.rows, calibrated.state.chain.rows)
    np.testing.assert_array_equal(state.T_flange_scanner, calibrated.state.T_flange_scanner)
    np.testing.assert_array_equal(state.T_base_station, calibrated.state.T_base_station)


def test_a_simulated_recording_is_one_cell_to_both(plan):
    assert_same_cell(simulated.observe(plan, 41))


def test_verification_poses_take_part_in_neither(plan):
    observed = simulated.observe(plan, 42)
    phase = np.where(np.arange(observed.n_poses) < 20, "verification", "position")
    phased = dataclasses.replace(observed, phase=phase)

    assert_same_cell(phased)
    assert prepare(phased).linear.obs.n_poses == observed.n_poses - 20


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("name", "nth"),
    [("example-none", 1), ("panda-sockets", 1), ("iiwa14-sockets", 1), ("ur5-tracker", 1), ("ur10-tracker-a", 6), ("ur10-tracker-c", 6)],
)
def test_an_open_recording_is_one_cell_to_both(shared_data, name, nth):
    """nth: of the poses of a long one, every sixth."""
    recorded = load_observations(shared_data / name)
    assert_same_cell(recorded.select(np.arange(recorded.n_poses) % nth == 0))


def test_a_clean_recording_keeps_the_noise_of_its_calibration(plan):
    observed = simulated.observe(plan, 43)

    full = fit_model(prepare(observed))

    assert full.model.members == ()
    np.testing.assert_allclose(
        full.noise.joint,
        calibrate(observed, CalibrationOptions(refuse=False, discrepancy=False, random_links=False)).noise.joint,
        rtol=1e-12,
    )


def test_a_latency_of_the_exposure_is_no_other_robot(plan):
    """Fast poses put the centres off by many millimetres: the damped fit ends at the cell, and the diagnosis goes on."""
    rng = np.random.default_rng(9)
    moving = dataclasses.replace(plan, velocity=rng.normal(0, np.radians(20.0), plan.q.shape))

    problem = prepare(simulated.observe(moving, 44, [("exposure_latency", ("scanner",), [0.02], None)]))

    assert np.median(np.linalg.norm(problem.linear.residual[problem.linear.keep, :3], axis=1)) < 30.0
    assert "exposure_latency" in {c.name for c in problem.candidates}
