"""A hundred simulated runs of the plan that ships: the errors at the bar are as large as each calibration expects of itself."""

from pathlib import Path

import numpy as np
import pytest

import mbcacq
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.plan import expand, load

PLAN = Path(__file__).parents[2] / "plans" / "kuka.yaml"
RUNS = 100


@pytest.fixture(scope="module")
def lengths():
    """(errors, standard uncertainties expected) (RUNS, places) mm, and (RUNS,) mm the part that is common to all places of a run."""
    loaded = load(PLAN)
    poses = expand(loaded)
    found = []
    for seed in range(RUNS):
        observations, _ = observe(loaded, poses, Scenario(0, "none", seed, (), 1, 1.0), [])
        found.append(mbcacq.calibrate(observations).verify(observations))
    errors, sigmas = (np.array([[getattr(p, key) for p in v.places] for v in found]) for key in ("after_mm", "expected_mm"))
    return errors, sigmas, np.array([v.common_mm for v in found])


def test_of_the_places_as_many_are_within_the_expected_uncertainty_as_it_says(lengths):
    errors, sigmas, _ = lengths
    assert 0.93 <= np.mean(np.abs(errors) < 2 * sigmas) <= 0.97


def test_that_the_errors_of_a_run_have_one_sign_follows_from_what_its_places_share(lengths):
    errors, sigmas, common = lengths
    of_runs = errors.mean(axis=1)
    assert np.sqrt(np.mean((of_runs / common) ** 2)) == pytest.approx(1.0, abs=0.2)  # a scale of each run, and none of all runs
    assert abs(of_runs.mean()) < 3 * of_runs.std() / np.sqrt(RUNS)
    alone = np.sqrt(np.mean(sigmas**2) - np.mean(common**2))
    assert np.std(errors - of_runs[:, None]) == pytest.approx(alone, rel=0.15)
    one_sign = np.mean(np.all(np.sign(errors) == np.sign(errors[:, :1]), axis=1))
    assert one_sign > 0.3
