"""The scanner's scale is read off the scans against the certificate; the calibration itself is blind to it."""

from dataclasses import replace

import numpy as np
import pytest
from cells import measure, scanner_cell, tracker_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import verify
from mbcacq.cli import tables
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.scan_scale import scan_scale


def grown(obs, ppm):
    return replace(obs, xyz=obs.xyz * (1 + 1e-6 * ppm))


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(51), stations=6, per_station=6, bars=4, preliminary=True)


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_a_scale_of_the_scanner_is_reported_with_a_warning(cell, method):
    """536 ppm leave the bar of 500 mm about 0.27 mm long, although each bar end is measured in the middle of the view."""
    options = CalibrationOptions(method=method, pairs="all", refuse=method == "ml")
    right, wrong = calibrate(cell.observations, options), calibrate(grown(cell.observations, 536), options)
    said, silent = wrong.to_dict()["scan_scale"], right.to_dict()["scan_scale"]
    assert said["ppm"] - silent["ppm"] == pytest.approx(536, abs=2)
    assert abs(said["ppm"] - 536) < 4 * said["sigma_ppm"] < 100
    assert said["significant"]
    assert not silent["significant"]
    lines = tables.scan_scale({"scan_scale": said})
    assert len(lines) == 2
    assert "longer than certified" in lines[1]
    assert len(tables.scan_scale({"scan_scale": silent})) == 1
    if method == "paper":
        return
    off = verify(grown(cell.observations, 536), wrong).errors("after") - verify(cell.observations, right).errors("after")
    assert off.mean() == pytest.approx(0.268, abs=0.05)


def test_its_uncertainty_is_that_of_the_noise_and_of_the_certificate():
    """Certificate: 1 um a coordinate. Over cells whose artefact is a draw from its certificate, error over sigma has rms 1."""
    rng, ratio = np.random.default_rng(52), []
    cell = scanner_cell(rng, stations=2, per_station=6)
    for _ in range(40):
        obs = measure(cell.observations, cell.truth, rng, (0.005, 0.005, 0.009), 8e-6)
        true = obs.cell.artefacts[0].centres + rng.normal(size=(8, 3)) * 0.001
        certified = replace(obs, cell=replace(obs.cell, artefacts=(replace(obs.cell.artefacts[0], centres=true),)))
        found = scan_scale(certified, np.ones(obs.n_centres, bool), np.full(3, 0.005))
        assert found.scans == 12
        assert found.certificate_ppm < found.sigma_ppm
        ratio.append(found.ppm / found.sigma_ppm)
    assert np.sqrt(np.mean(np.square(ratio))) == pytest.approx(1, abs=3 / np.sqrt(80))


def test_no_scale_where_no_scan_shows_two_balls(cell):
    assert calibrate(tracker_cell(np.random.default_rng(1)).observations).to_dict()["scan_scale"] is None
    bars = cell.observations.select(cell.observations.phase == "verification")
    assert scan_scale(bars, np.ones(bars.n_centres, bool), np.full(3, 0.005)) is None
