"""The design matrix of a term is the derivative of the forward model by its coefficients."""

from dataclasses import replace

import numpy as np
import pytest
from cells import scanner_cell, tracker_cell

from mbcacq.estimation import forward_model, parameters
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.pose_columns import WIDE
from mbcacq.estimation.pose_information import PoseInformation
from mbcacq.estimation.terms import Part, accumulate, columns, term


def residual_derivative(obs, state, one, h=1e-4):
    """Central differences of (measured minus predicted), sign turned."""
    out = []
    for j in range(one.size):
        c = np.zeros(one.size)
        c[j] = h
        up = forward_model.residual(obs, forward_model.predict(obs, state, accumulate(obs, [one], [c])))
        c[j] = -h
        down = forward_model.residual(obs, forward_model.predict(obs, state, accumulate(obs, [one], [c])))
        out.append((down - up) / (2 * h))
    return np.stack(out, axis=-1)


PLACES = (
    [("joint", i, 0) for i in (0, 3, 5)]
    + [("frame", i, c) for i in (0, 2, 6) for c in range(6)]
    + [("station", 0, c) for c in range(6)]
    + [("point", 0, c) for c in range(3)]
    + [("ball", 0, c) for c in range(3)]
)


@pytest.mark.parametrize(("place", "index", "component"), PLACES)
def test_columns_are_derivatives_with_a_scanner(place, index, component):
    rng = np.random.default_rng(1)
    cell = scanner_cell(rng, stations=2, per_station=2)
    obs, state = cell.observations, cell.truth
    rows = obs.n_poses if place in ("joint", "frame", "station") else obs.n_centres
    one = term("x", [Part(place, index, component, rng.normal(size=(rows, 2)))])
    analytic = columns(obs, forward_model.predict(obs, state), one)
    np.testing.assert_allclose(analytic, residual_derivative(obs, state, one), atol=2e-4, rtol=1e-6)


@pytest.mark.parametrize("orientation", [False, True])
@pytest.mark.parametrize(("place", "index", "component"), [p for p in PLACES if p[0] != "ball"])
def test_columns_are_derivatives_with_a_tracker(place, index, component, orientation):
    rng = np.random.default_rng(2)
    cell = tracker_cell(rng, poses=5, orientation=orientation)
    obs, state = cell.observations, cell.truth
    one = term("x", [Part(place, index, component, rng.normal(size=(5, 2)))])
    analytic = columns(obs, forward_model.predict(obs, state), one)
    np.testing.assert_allclose(analytic, residual_derivative(obs, state, one), atol=2e-4, rtol=1e-6)


def test_parts_share_their_coefficients():
    rng = np.random.default_rng(3)
    cell = scanner_cell(rng, stations=1, per_station=3)
    obs, state = cell.observations, cell.truth
    a = Part("joint", 1, 0, rng.normal(size=(obs.n_poses, 1)))
    b = Part("point", 0, 2, rng.normal(size=(obs.n_centres, 1)))
    prediction = forward_model.predict(obs, state)
    both = columns(obs, prediction, term("both", [a, b]))
    np.testing.assert_allclose(both, columns(obs, prediction, term("a", [a])) + columns(obs, prediction, term("b", [b])))


def test_shapes_that_disagree_are_refused():
    rng = np.random.default_rng(4)
    obs = scanner_cell(rng, stations=1, per_station=2).observations
    with pytest.raises(ValueError, match="different numbers"):
        term("x", [Part("joint", 0, 0, np.zeros((2, 1))), Part("joint", 1, 0, np.zeros((2, 2)))])
    with pytest.raises(ValueError, match="rows, expected 16"):
        accumulate(obs, [term("x", [Part("point", 0, 0, np.zeros((2, 1)))])], [np.zeros(1)])


@pytest.mark.parametrize(("place", "index", "component"), [("joint", 2, 0), ("frame", 4, 3), ("station", 0, 5)])
def test_products_of_many_functions_of_one_direction_are_those_of_their_columns(place, index, component):
    rng = np.random.default_rng(2)
    cell = tracker_cell(rng, 80, orientation=True)
    obs, functions = cell.observations, rng.normal(size=(80, WIDE))
    several = (
        term("wide", [Part(place, index, component, functions)], sigma=1.0),
        term("narrow", [Part("joint", 1, 0, rng.normal(size=(80, 2)))], sigma=1.0),
    )
    several = (*several, term("other", [Part("joint", 0, 0, rng.normal(size=(80, WIDE + 1)))], sigma=1.0))
    options = CalibrationOptions(terms=several)
    lineariser = Lineariser(obs, parameters.build(obs, options), options)
    found = lineariser.at(lineariser.evaluate(parameters.Estimate(cell.truth, tuple(np.zeros(t.size) for t in several))))
    noise = Noise(np.full(3, 0.02), np.full(6, 1e-5), 1e-4)

    poses = [
        PoseInformation.of(lineariser.rows, columns, noise, rng.integers(0, 2, obs.n_centres).astype(float), np.ones(80))
        for rng, columns in ((np.random.default_rng(3), found), (np.random.default_rng(3), replace(found, wide=())))
    ]

    assert len(found.wide) == 2
    for one, other in zip(*((*p.products(), *p.right_hand_side()) for p in poses), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())
