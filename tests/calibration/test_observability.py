"""Observability indices on matrices whose answer is known; the map of expected accuracy follows the covariance."""

import numpy as np
import pytest
from cells import scanner_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.workspace_accuracy import accuracy_map, indices


def test_indices_of_a_diagonal_information():
    found = indices(np.diag([4.0, 16.0, 100.0]), np.ones(3), 4)  # singular values 2, 4, 10
    assert found["O1"] == pytest.approx((2 * 4 * 10) ** (1 / 3) / 2)
    assert found["O2"] == pytest.approx(0.2)
    assert found["O3"] == pytest.approx(2)
    assert found["O4"] == pytest.approx(0.4)
    assert found["O5"] == pytest.approx(1 / (0.5 + 0.25 + 0.1))
    assert set(indices(np.diag([0.0, 1.0]), np.ones(2), 4).values()) == {0.0}


def test_more_orientation_and_more_stations_show_in_the_indices():
    poor = calibrate(scanner_cell(np.random.default_rng(1), stations=5, per_station=8, tilt_deg=15).observations).observability
    rich = calibrate(scanner_cell(np.random.default_rng(1), stations=10, per_station=8, tilt_deg=35).observations).observability
    # O2 and O4 may fall: they compare with the largest singular value, which grows as well.
    assert all(rich[name] > poor[name] for name in ("O1", "O3", "O5"))


def test_map_of_expected_accuracy():
    found = calibrate(scanner_cell(np.random.default_rng(2), stations=8, per_station=8).observations)
    chart = accuracy_map(found, found.fit.observations, cell_mm=400)
    assert chart.postures.sum() == 4000
    assert np.all(chart.sigma_mm > 0)
    near = np.linalg.norm(chart.centres_mm - found.state.T_base_station[:, :3, 3].mean(axis=0), axis=1)
    # Accuracy is best where the stations stood.
    assert np.median(chart.sigma_mm[near < 600]) < np.median(chart.sigma_mm[near > 1500])
