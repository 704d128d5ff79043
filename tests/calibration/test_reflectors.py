"""A tracker that sees several reflectors of one target on the flange."""

from dataclasses import replace

import numpy as np
import pytest
from cells import measure, tracker_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.estimation import forward_model, parameters
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.geometry import se3
from mbcacq.model.cell import Artefact

REFLECTORS = np.array([[0.0, 0, 0], [115.0, 0, 0], [-10.0, 184.0, 5.5]])


def three_reflectors(rng, orientation=False, poses=150):
    """The same target seen at three places, its frame turned on the flange by what nobody told."""
    one = tracker_cell(rng, poses, orientation=orientation)
    artefact = Artefact("tracker", "tracker", (1, 2, 3), REFLECTORS, np.zeros(3), uncertainty_mm=0.005)
    obs = one.observations
    cell = replace(obs.cell, artefacts=(artefact,))
    index = np.repeat(np.arange(poses), 3)
    obs = replace(
        obs,
        cell=cell,
        pose=index,
        ball=np.tile(np.arange(3), poses),
        xyz=np.zeros((3 * poses, 3)),
        rotation=np.tile(np.eye(3), (3 * poses, 1, 1)) if orientation else None,
    )
    truth = replace(
        one.truth, balls=REFLECTORS + rng.normal(size=(3, 3)) * 0.005, T_flange_scanner=se3.exp(np.array([30.0, -20, 90, 0.3, -0.2, 1.1]))
    )
    if orientation:
        obs = replace(obs, rotation=forward_model.predict(obs, truth).rotation)
    return measure(obs, truth, rng, np.full(3, 0.02), 1e-5), truth


def test_orientation_of_the_target_and_positions_of_the_reflectors_are_recovered():
    obs, truth = three_reflectors(np.random.default_rng(3))
    result = calibrate(obs)
    turn = se3.rotation_log((result.state.T_flange_scanner[:3, :3].T @ truth.T_flange_scanner[:3, :3])[None])[0]
    assert np.linalg.norm(turn) < 1.5e-4
    q = np.random.default_rng(4).uniform(-1, 1, (50, 6))
    found = result.state.chain.flange(q) @ result.state.T_flange_scanner
    true = truth.chain.flange(q) @ truth.T_flange_scanner
    to_base = result.state.T_base_station[0] @ se3.inverse(truth.T_base_station[0])  # the base itself is not seen
    off = se3.apply(found, REFLECTORS[2]) - se3.apply(to_base[None] @ true, REFLECTORS[2])
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 0.05


@pytest.mark.parametrize("orientation", [False, True])
def test_columns_are_derivatives_of_what_is_measured(orientation):
    obs, truth = three_reflectors(np.random.default_rng(5), orientation, poses=12)
    options = CalibrationOptions()
    layout = parameters.build(obs, options)
    lineariser = Lineariser(obs, layout, options)
    at, still = parameters.Estimate(truth), np.zeros((1, 6))
    assert layout.blocks[2].free.all()
    columns = lineariser.rows.unpad(lineariser.at(lineariser.evaluate(at)).dense)
    for j, name in enumerate(layout.names):
        step = 1e-4 * (np.arange(layout.size) == j)
        ends = [lineariser.evaluate(at.moved(layout, s * step, still)).residual for s in (-1, 1)]
        np.testing.assert_allclose(columns[..., j], (ends[0] - ends[1]) / 2e-4, atol=1e-3, rtol=1e-5, err_msg=name)
