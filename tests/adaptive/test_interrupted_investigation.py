"""An investigation that is killed in a visit and resumed decides and measures what an undisturbed one does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import simulated_cell
from simulated_cell import BUDGET, simulated_plan

import mbcacq
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import fields_as_json


def killed(*arguments: object) -> None:
    script = [sys.executable, simulated_cell.__file__, *map(str, arguments)]
    two_threads = {**os.environ, "OPENBLAS_NUM_THREADS": "2"}  # of linear algebra, as a program has that imports the library: here is one
    done = subprocess.run(script, capture_output=True, text=True, timeout=900, check=False, env=two_threads)
    assert done.returncode == -signal.SIGKILL, done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL is of other systems")
def test_killed_in_a_visit_and_resumed_it_decides_and_measures_the_same(tmp_path: Path):
    plan = simulated_plan(tmp_path, "concealed.yaml")
    undisturbed = list(mbcacq.investigate(plan, BUDGET, out=tmp_path / "whole", dry_run=True))
    assert [d.poses for d in undisturbed] == [24, 30]
    killed(plan, tmp_path / "killed", 24 + 3)
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
