"""A whole plan through EKI: recorded, calibrated, and the same calibration as through RSI within the noise."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from mbcacq.calibration.calibrate import calibrate
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.recording import load_observations


@pytest.fixture(scope="module")
def benchmark():
    sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
    import whole_runs

    return whole_runs


def test_eki_and_rsi_calibrate_the_same_cell(benchmark, tmp_path):
    """One true cell, independent noise: 24 parameters apart by no more than their stated uncertainty. The full plan: docs/kuka.md."""
    results, moved = {}, {}
    for seed, driver in enumerate(("kuka_rsi", "kuka_eki"), 5):
        run = load_observations(benchmark.record("quick.yaml", driver, seed, tmp_path / driver))
        results[driver], moved[driver] = calibrate(run, CalibrationOptions(refuse=False)).to_dict(), run.q
    np.testing.assert_allclose(moved["kuka_rsi"], moved["kuka_eki"], atol=2e-4)  # both stand where the plan says
    assert np.abs(moved["kuka_rsi"] - moved["kuka_eki"]).max() > 0
    _, value, n = benchmark.difference(results["kuka_rsi"], results["kuka_eki"])
    assert n >= 15
    assert value < chi2.ppf(0.999, n)
