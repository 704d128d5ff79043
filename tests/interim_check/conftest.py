"""One calibrated cell serves all tests of checks."""

from pathlib import Path

import pytest

import mbcacq
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.model.json_text import sealed_text
from mbcacq.plan import expand, load

PLAN = Path(__file__).parents[2] / "plans" / "kuka.yaml"


@pytest.fixture(scope="session")
def learnt(made_once):
    """Its result.json; to be looked at only."""

    def make(folder):
        loaded = load(PLAN)
        observations, _ = observe(loaded, expand(loaded), Scenario(0, "none", 3, (), 1, 1.0), [])
        (folder / "result.json").write_text(sealed_text(mbcacq.calibrate(observations).to_dict() | {"simulated": True}))

    return made_once("learnt", make) / "result.json"
