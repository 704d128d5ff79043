"""Cells with a track, a turntable, a stroke or a gantry: the true geometry is found as well as the stated covariance says."""

import joint_cells as made
import numpy as np
import pytest

from mbcacq.calibration.calibrate import calibrate
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.estimation.forward_model import predict
from mbcacq.estimation.options import CalibrationOptions

FREE = CalibrationOptions(random_links=False, discrepancy=False)
SEEDS = 3


def along_a_track(rng):
    side = rng.uniform(500, 800, 8) * np.array([1, -1] * 4)
    return made.scanner_cell(made.on_a_track(), rng, np.column_stack([np.linspace(300, 4300, 8), side, rng.uniform(0, 500, 8)]), 8)


def on_a_table(rng):
    centres = np.array([900.0, 0, 250]) + rng.uniform(-1, 1, (8, 3)) * [250, 250, 150]
    return made.scanner_cell(made.at_a_turntable(), rng, centres, 8)


def under_a_gantry(rng):
    return made.scanner_cell(made.gantry(), rng, rng.uniform([200, 200, -300], [1800, 1300, 300], (8, 3)), 8)


def by_a_tracker(rng):
    return made.tracker_cell(made.scara(), rng, 120)


@pytest.mark.parametrize("cell", [along_a_track, on_a_table, under_a_gantry, by_a_tracker])
def test_errors_are_as_large_as_stated(cell):
    """The normalised error squared of the links over a few cells is chi square distributed, the mean of some 60 degrees of freedom."""
    total, count = 0.0, 0
    for seed in range(SEEDS):
        truth = cell(np.random.default_rng(seed))
        found = calibrate(truth.observations, FREE)
        error, covariance = made.arm_error(found, truth)
        scale = np.sqrt(np.diag(covariance))
        total += (error / scale) @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale)
        count += len(error)
    assert abs(total / count - 1) < 4 * np.sqrt(2 / count)


def test_rails_that_are_not_straight_are_learnt_along_the_track():
    """0.1 mm of straightness, 0.2 mrad of yaw and 50 ppm of scale on 4 m: points at both ends of the track are then where the cell says."""

    def rails(s):
        u = np.pi * s / 4000
        twist = np.zeros((len(s), 6))
        # The frame behind the track's row: its own displacement along the track and across, and its turn about the vertical.
        twist[:, 1], twist[:, 2], twist[:, 4] = 0.1 * np.sin(2 * u), 50e-6 * s, 2e-4 * np.sin(u)
        return twist

    rng = np.random.default_rng(4)
    side = rng.uniform(500, 800, 14) * np.array([1, -1] * 7)
    centres = np.column_stack([np.linspace(200, 4400, 14), side, rng.uniform(0, 500, 14)])
    truth = made.scanner_cell(made.on_a_track(), rng, centres, 14, guide=rails)
    learnt, rigid = calibrate(truth.observations), calibrate(truth.observations, FREE)
    assert learnt.noise.joint[0] < 0.02  # mm: what the rails do is not taken for noise of the track
    assert rigid.noise.joint[0] > 2 * learnt.noise.joint[0]


def test_effects_of_angles_are_not_asked_of_a_slide():
    """A gear's periods a turn, or a zero in rad per kelvin, are no effects of a track; the scale of its drive is one, in mm."""
    truth = made.scanner_cell(made.on_a_track(), np.random.default_rng(0), np.array([[600.0, 500, 100], [2600, -500, 200]]), 6)
    obs = truth.observations
    found, _ = catalogue.candidates(Context(obs, truth.truth, predict(obs, truth.truth)))
    at_the_track = [c for c in found if "E1" in c.where]
    assert {c.name for c in at_the_track} == {"joint_scale", "axis_error_motion"}
    assert {part.covariates for c in at_the_track for part in c.parts(0.0)} == {frozenset({"sE1"})}
    assert {"A1", "A2"} <= {c.where[0] for c in found}
