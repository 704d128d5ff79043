"""Sphere spacing errors of a known wrong cell, and verdicts that mind the uncertainty of measuring."""

from dataclasses import replace

import numpy as np
import pytest
from cells import scanner_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import verify
from mbcacq.calibration.verification import judge, verdict
from mbcacq.geometry import se3


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(41), stations=6, per_station=8, bars=5)


def test_the_true_cell_shows_noise_only_and_a_wrong_arm_shows_its_error(cell):
    obs = cell.observations
    true = verify(obs, cell.truth)
    assert len(true.places) == 5
    assert np.abs(true.errors("after")).max() < 0.06
    state = cell.truth
    longer = replace(state, chain=state.chain.with_errors(np.array([[0, 0, 0, 0, 0], [0, 0, 5.0, 0, 0], *np.zeros((4, 5))])))
    errors = verify(obs, longer, before=state)
    assert np.abs(errors.errors("after")).max() > 0.5
    np.testing.assert_allclose(errors.errors("before"), true.errors("after"))
    for place, s in zip(errors.places, range(6, 11), strict=True):
        ends = []
        for ball in (8, 9):
            rows = np.flatnonzero((obs.station[obs.pose] == s) & (obs.ball == ball))
            seen = [se3.apply(longer.chain.flange(obs.q[[obs.pose[m]]])[0] @ longer.T_flange_scanner, obs.xyz[m]) for m in rows]
            ends.append(np.mean(seen, axis=0))
        assert place.after_mm == pytest.approx(np.linalg.norm(ends[0] - ends[1]) - 500)


def test_nothing_to_verify_on_is_said(cell):
    obs = cell.observations
    result = verify(obs.select(obs.phase == "position"), cell.truth)
    assert result.places == ()
    assert result.to_dict() is None


def test_verdicts_keep_clear_of_the_limit():
    assert verdict(0.02, 0.001, 0.03) == "pass"
    assert verdict(0.0295, 0.001, 0.03) == "undecided"
    assert verdict(0.0305, 0.001, 0.03) == "undecided"
    assert verdict(0.04, 0.001, 0.03) == "fail"
    assert verdict(0.04, 0.001, None) == "none"
    assert verdict(None, None, 0.03) == "none"


def test_figures_after_the_guideline(cell):
    obs = replace(cell.observations, rms_mm=np.full(cell.observations.n_centres, 0.01), n_points=np.full(cell.observations.n_centres, 2000))
    found = calibrate(obs)
    figures = {f.name.split(" (")[0]: f for f in judge(obs, found.state, found.effects, found.verify(obs, limit_mm=0.5))}
    assert figures["sphere spacing error"].verdict == "pass"
    assert figures["sphere spacing error"].count == 5
    assert figures["length measuring error"].count == 5 * 4  # two scans of each ball
    assert figures["probing error, form"].value_mm == pytest.approx(0.04)
    assert figures["probing error, size"].verdict == "none"
