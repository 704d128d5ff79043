"""An investigation that is killed in a visit and resumed decides and measures what an undisturbed one does."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from simulated_cell import BUDGET, simulated_plan

import mbcacq
from mbcacq.acquisition import events
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import fields_as_json


def keep_as_killed(folder: Path, kept: Path, poses: int):
    """A subscriber that keeps what kill -9 would leave of the folder, once so many poses were measured: its files as the system has them."""
    done = []

    def subscriber(event: events.Event) -> None:
        if isinstance(event, events.PoseDone):
            done.append(event)
            if len(done) == poses:
                shutil.copytree(folder, kept)

    return subscriber


def test_killed_in_a_visit_and_resumed_it_decides_and_measures_the_same(tmp_path: Path):
    one = {"name": "joint_compliance", "where": "A2", "compliance_rad_per_Nm": 2e-6}  # of four that the plan conceals: weighed sooner
    plan = simulated_plan(tmp_path, "concealed.yaml", fake={"draws": "pose", "pitch_mm": 1.0, "hidden": [one]})
    operator = mbcacq.Operator(subscribers=(keep_as_killed(tmp_path / "whole", tmp_path / "killed", 24 + 3),))
    undisturbed = list(mbcacq.investigate(plan, BUDGET, out=tmp_path / "whole", dry_run=True, operator=operator))
    assert [d.poses for d in undisturbed] == [24, 30]
    going = mbcacq.investigate(None, resume=tmp_path / "killed", dry_run=True)
    assert len(going.decisions) == 1  # the first stands, and is not made anew
    decided = list(going)
    assert [fields_as_json(d) for d in decided] == [fields_as_json(d) for d in undisturbed]  # every figure, to the last bit
    whole, again = (mbcacq.load_observations(tmp_path / name) for name in ("whole", "killed"))
    assert np.array_equal(again.pose_id, whole.pose_id)
    assert np.array_equal(again.ball, whole.ball)
    assert np.array_equal(again.direction, whole.direction)
    assert np.abs(again.q - whole.q).max() < 1e-12
    assert np.array_equal(again.xyz, whole.xyz)
    assert np.array_equal(again.time_s, whole.time_s)


def test_a_folder_without_an_investigation_is_not_resumed(tmp_path: Path):
    with pytest.raises(ConfigError, match="holds no investigation to resume"):
        mbcacq.investigate(None, resume=tmp_path, dry_run=True)


def test_an_investigation_that_is_refused_leaves_no_folder_behind(tmp_path: Path):
    """Nobody allows the arm to move: nothing is measured, so there is nothing to go on with."""
    with pytest.raises(ConfigError, match="give an operator"):
        next(iter(mbcacq.investigate(simulated_plan(tmp_path, "concealed.yaml"), BUDGET, out=tmp_path / "run")))
    assert not (tmp_path / "run").exists()
