"""A finished run is extended by a plan of its cell: one recording, the measured poses untouched."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import mbcacq
from mbcacq.errors import ConfigError
from mbcacq.model import yaml12
from mbcacq.plan import load
from mbcacq.recording.run_folder.run_plan import read_kept_plan

PLAN = Path(__file__).parents[2] / "plans" / "quick.yaml"
MORE = {
    "name": "more",
    "phase": "orientation",
    "do": "look",
    "stations": ["p1"],
    "views": [{"tilt_deg": 30, "azimuth_deg": 10, "roll_deg": -20}],
}


def further(**keys):
    return load(PLAN, yaml12.dump({**yaml12.load(PLAN.read_text(encoding="utf-8")), "steps": [MORE], **keys}, allow_unicode=True))


@pytest.fixture
def run_folder(finished_run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished_run("quick.yaml").folder, folder)
    return folder


def test_a_run_grows_by_the_poses_of_another_plan(run_folder):
    before = mbcacq.load_observations(run_folder)
    said: list[str] = []
    mbcacq.extend(run_folder, further(), dry_run=True, operator=mbcacq.Operator(message=said.append, assume_yes=True))
    after = mbcacq.load_observations(run_folder)
    assert after.n_poses == before.n_poses + 1
    assert np.array_equal(after.xyz[: before.n_centres], before.xyz)
    assert np.array_equal(after.pose_id, np.arange(after.n_poses))
    assert not [sentence for sentence in said if "stands" in sentence]
    assert read_kept_plan(run_folder).grown_from == before.n_poses


def test_a_run_of_another_fake_cell_is_not_extended(run_folder):
    with pytest.raises(ConfigError, match="was recorded with the fake cell of seed 0"):
        mbcacq.extend(run_folder, further(), dry_run=True, seed=5)


def test_a_plan_of_another_cell_does_not_extend_a_run(run_folder):
    with pytest.raises(ConfigError, match="'exposures' is not as in the plan of the recording"):
        mbcacq.extend(run_folder, further(exposures=4), dry_run=True)
