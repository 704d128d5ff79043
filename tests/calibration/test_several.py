"""Several artefacts in one fit, stations whose place is known, and parameters that no measurement of the kind can tell apart."""

from dataclasses import replace

import numpy as np
import pytest
from cells import measure, scanner_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.cli import tables
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Station

NOISE = (0.005, 0.005, 0.009)


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(71), stations=5, per_station=6, bars=5)


def normalised(found, errors):
    off = (found.errors - errors).reshape(-1)[found.layout.blocks[0].free]
    n = len(off)
    return off @ np.linalg.solve(found.covariance[:n, :n], off), n


def test_eight_balls_and_the_long_bar_together(cell):
    """The bar, end by end, holds the arm's lengths: with it in the fit every length is better known, and right."""
    obs = cell.observations
    both, alone = calibrate(replace(obs, phase=None)), calibrate(obs)
    assert {s.artefact for i, s in enumerate(obs.cell.stations) if i in both.fit.observations.station} == {"mbc", "bar"}
    d, n = normalised(both, cell.errors)
    assert d < n + 4 * np.sqrt(2 * n)
    assert both.expected_accuracy() < 0.6 * alone.expected_accuracy()
    for name in ("a_2", "d_4", "a_1"):
        std = [np.sqrt(c.covariance[c.names.index(name), c.names.index(name)]) for c in (both, alone)]
        assert std[0] < 0.8 * std[1]


def test_normalised_errors_with_two_artefacts_follow_chi_square(cell):
    rng, values = np.random.default_rng(72), []
    for _ in range(20):
        d, n = normalised(calibrate(replace(measure(cell.observations, cell.truth, rng, NOISE, 8e-6), phase=None)), cell.errors)
        values.append(d)
    assert np.mean(values) == pytest.approx(n, abs=4 * np.sqrt(2 * n / 20))


def test_parameters_that_cannot_be_told_apart_are_named():
    """Two axes nearly parallel (0.5 deg): d_2 and d_3 shift almost alike; the pair is named, with a correlation near one."""
    deg = np.pi / 180
    chain = Chain(
        sign=np.array([-1.0, 1, 1, -1, 1, -1]),
        theta=np.array([0, 0, -90, 0, 0, 180]) * deg,
        d=np.array([450.0, 0, 0, 660, 0, 80]),
        a=np.array([150.0, 610, 20, 0, 0, 0]),
        alpha=np.array([-90, 0.5, -90, 90, -90, 180]) * deg,
        beta=np.zeros(6),
    )
    found = calibrate(scanner_cell(np.random.default_rng(73), chain=chain, errors=np.zeros((6, 5)), stations=5, per_station=5).observations)
    named = {frozenset((a, b)): r for a, b, r in found.fit.correlated}
    held = " ".join(found.layout.held.values())
    assert abs(named.get(frozenset(("d_2", "d_3")), 0.0)) > 0.99 or "d_3" in held or "d_2" in held
    lines = tables.remarks(found.to_dict())
    assert any("d_2" in line and "d_3" in line for line in lines)


def test_a_known_station_and_an_unknown_one_agree(cell):
    """One station given in the base within 10 um: theta_1 and d_1 become free, the rest of the cell is none the worse."""
    obs = cell.observations
    stations = tuple(
        Station(s.id, s.artefact, cell.truth.T_base_station[i] if i == 0 else None, 0.01 if i == 0 else None)
        for i, s in enumerate(obs.cell.stations)
    )
    known = calibrate(replace(obs, cell=replace(obs.cell, stations=stations)))
    assert {"theta_1", "d_1"} <= set(known.names)
    d, n = normalised(known, cell.errors)
    assert d < n + 4 * np.sqrt(2 * n)
