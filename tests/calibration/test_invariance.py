"""What is only a way of writing things down does not change what is found: frames, units, senses and zeros of joints, names of balls."""

from dataclasses import replace

import numpy as np
import pytest
from cells import MBC, scanner_cell, tracker_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.errors import CalibrationError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain

METHODS = [CalibrationOptions(), CalibrationOptions(method="paper", pairs="four", refuse=False)]
IDS = ["ml", "paper"]


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(61), stations=6, per_station=6, preliminary=True)


@pytest.fixture(scope="module")
def found(cell):
    return {o.method: calibrate(cell.observations, o) for o in METHODS}


def identified(calibration):
    """MD-H errors (n, 5) without the last link's: the paper's method leaves them free beside the hand-eye transform, which does the same."""
    return calibration.errors[:-1]


def with_cell(obs, **changes):
    return replace(obs, cell=replace(obs.cell, **changes))


def with_chain(obs, chain, q=None):
    return replace(with_cell(obs, robot=replace(obs.cell.robot, chain=chain)), q=obs.q if q is None else q)


@pytest.mark.parametrize("options", METHODS, ids=IDS)
def test_where_the_base_frame_is_turned_to_and_lifted(cell, found, options):
    """Another zero of theta_1 and d_1: the base turns about its z axis and moves along it; every station moves with it."""
    chain, still = cell.observations.cell.robot.chain, found[options.method]
    rows = chain.rows.copy()
    rows[0, :2] += [0.7, -120.0]
    again = calibrate(with_chain(cell.observations, Chain(chain.sign, *rows.T)), options)
    T = se3.exp(np.array([0, 0, -120.0, 0, 0, 0])) @ se3.exp(np.array([0, 0, 0, 0, 0, 0.7]))
    np.testing.assert_allclose(again.errors, still.errors, atol=2e-6)
    np.testing.assert_allclose(again.state.T_flange_scanner, still.state.T_flange_scanner, atol=2e-6)
    np.testing.assert_allclose(again.state.T_base_station, T @ still.state.T_base_station, atol=1e-5)


@pytest.mark.parametrize("options", METHODS, ids=IDS)
def test_which_frame_the_certificate_is_written_in(cell, found, options):
    T = se3.exp(np.array([250.0, -40, 90, 0.5, -1.1, 0.8]))
    artefact = cell.observations.cell.artefacts[0]
    again = calibrate(with_cell(cell.observations, artefacts=(replace(artefact, centres=se3.apply(T, artefact.centres)),)), options)
    still = found[options.method]
    np.testing.assert_allclose(again.errors, still.errors, atol=2e-5)
    np.testing.assert_allclose(again.state.T_flange_scanner, still.state.T_flange_scanner, atol=2e-5)
    np.testing.assert_allclose(again.state.T_base_station @ T, still.state.T_base_station, atol=2e-4)


@pytest.mark.parametrize("options", METHODS, ids=IDS)
def test_how_the_scanner_names_its_axes(cell, found, options):
    """x y z of the scanner become z x y; its noise goes with them."""
    turn = se3.transform(np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), np.zeros(3))
    obs = replace(cell.observations, xyz=se3.apply(turn, cell.observations.xyz))
    again = calibrate(with_cell(obs, noise_mm=obs.cell.noise_mm[[2, 0, 1]]), options)
    still = found[options.method]
    np.testing.assert_allclose(again.errors, still.errors, atol=2e-6)
    np.testing.assert_allclose(again.state.T_flange_scanner @ turn, still.state.T_flange_scanner, atol=2e-6)
    np.testing.assert_allclose(again.noise.point, still.noise.point[[2, 0, 1]], rtol=1e-4)


@pytest.mark.parametrize("options", METHODS, ids=IDS)
def test_directions_of_rotation_and_zeros_of_the_joints(cell, found, options):
    """The same arm with every angle counted the other way round, from another zero."""
    chain, obs = cell.observations.cell.robot.chain, cell.observations
    zero = np.array([0.3, -0.2, 0.5, 1.0, -0.7, 0.1])
    other = Chain(-chain.sign, chain.theta + chain.sign * zero, chain.d, chain.a, chain.alpha, chain.beta)
    again = calibrate(with_chain(obs, other, -(obs.q - zero)), options)
    np.testing.assert_allclose(again.errors, found[options.method].errors, atol=2e-6)


@pytest.mark.parametrize("options", METHODS, ids=IDS)
def test_order_and_names_of_the_balls(cell, found, options):
    order = np.random.default_rng(3).permutation(8)
    obs, artefact = cell.observations, cell.observations.cell.artefacts[0]
    renamed = replace(artefact, ball_ids=tuple(range(101, 109)), centres=artefact.centres[order])
    ball = np.argsort(order)[obs.ball]
    again = calibrate(replace(with_cell(obs, artefacts=(renamed,)), ball=ball), replace(options, pairs="all"))
    still = calibrate(obs, replace(options, pairs="all"))
    np.testing.assert_allclose(identified(again), identified(still), atol=2e-6)
    np.testing.assert_allclose(again.state.balls, still.state.balls[order], atol=1e-6)


@pytest.mark.parametrize("method", IDS)
def test_the_unit_of_length(cell, method):
    """Everything written in half millimetres: twice the numbers, the same angles. What is plausible is stated in mm, and taken so
    loosely that it does not matter."""
    obs, options = cell.observations, METHODS[IDS.index(method)]
    chain, artefact = obs.cell.robot.chain, obs.cell.artefacts[0]
    X = obs.cell.T_flange_scanner.copy()
    X[:3, 3] *= 2
    double = replace(
        obs,
        xyz=2 * obs.xyz,
        cell=replace(
            obs.cell,
            T_flange_scanner=X,
            noise_mm=2 * obs.cell.noise_mm,
            robot=replace(
                obs.cell.robot,
                chain=Chain(chain.sign, chain.theta, 2 * chain.d, 2 * chain.a, chain.alpha, chain.beta),
                repeatability_mm=2 * obs.cell.robot.repeatability_mm,
            ),
            artefacts=(replace(artefact, centres=2 * artefact.centres, uncertainty_mm=2 * artefact.uncertainty_mm),),
        ),
    )
    again, still = calibrate(double, options), calibrate(obs, options)
    np.testing.assert_allclose(identified(again) / [1, 2, 2, 1, 1], identified(still), atol=1e-5)
    np.testing.assert_allclose(again.noise.point, 2 * still.noise.point, rtol=1e-3)
    for name, factor in (("a_2", 2), ("theta_3", 1), ("alpha_4", 1)):
        i = again.names.index(name)
        assert np.sqrt(again.covariance[i, i]) == pytest.approx(factor * np.sqrt(still.covariance[i, i]), rel=0.01)


@pytest.mark.parametrize("options", METHODS, ids=IDS)
def test_centres_in_metres_are_refused_beside_a_certificate_in_mm(cell, options):
    with pytest.raises(CalibrationError):
        calibrate(replace(cell.observations, xyz=1e-3 * cell.observations.xyz), replace(options, refuse=True))


@pytest.mark.parametrize("orientation", [False, True])
def test_frame_of_the_tracker(orientation):
    cell = tracker_cell(np.random.default_rng(9), orientation=orientation)
    obs, T = cell.observations, se3.exp(np.array([500.0, 20, -900, 0.5, -1.0, 0.7]))
    rotation = None if obs.rotation is None else T[:3, :3] @ obs.rotation
    moved = calibrate(replace(obs, xyz=se3.apply(T, obs.xyz), rotation=rotation))
    still = calibrate(obs)
    std = np.sqrt(np.diag(still.covariance))
    free = still.layout.blocks[0].free
    # The noise is estimated axis by axis, so a turn of the axes changes weights a little: far within one sigma.
    off = np.abs(moved.errors - still.errors).reshape(-1)[free]
    assert np.all(off < 0.5 * std[: len(off)])


def test_balls_of_the_artefact_are_the_ones_certified():
    """Guards the tests above: the artefact has no symmetry that would hide a wrong order."""
    d = np.linalg.norm(MBC[:, None] - MBC, axis=2)
    rows = np.sort(d, axis=1)
    apart = np.abs(rows[:, None] - rows).max(axis=2) + 100 * np.eye(8)
    assert apart.min() > 2.0
