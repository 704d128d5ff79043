"""Investigations that are killed and resumed: do they decide and measure what an undisturbed one does?"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bench
import numpy as np

sys.path.insert(0, str(bench.TESTS / "adaptive"))
import simulated_cell

import mbcacq
from investigate.cells import Table
from mbcacq.model.json_text import fields_as_json
from mbcacq.model.observations import Observations
from mbcacq.recording.rrd.layout import INVESTIGATION_FILE

COMPARED_EXACTLY = ("pose_id", "ball", "q", "xyz", "time_s", "direction")  # of two recordings, bit by bit


class Undisturbed:
    """An investigation of a simulated cell that nothing disturbs: its decisions, observations, calibration and seconds."""

    def __init__(self, folder: Path):
        self.plan = simulated_cell.simulated_plan(folder, "concealed.yaml")
        began = time.monotonic()
        self.decided = list(mbcacq.investigate(self.plan, simulated_cell.BUDGET, out=folder / "whole", dry_run=True))
        self.seconds = time.monotonic() - began
        self.observed = mbcacq.load_observations(folder / "whole")
        self.calibrated = figures_of(self.observed)

    def killed(self, folder: Path, poses: int | None, seconds: float) -> tuple[bool, int]:
        """Kill -9 after so many poses, or after a time; whether it was in time, and how many poses were measured."""
        script = [sys.executable, simulated_cell.__file__, str(self.plan), str(folder), str(poses or 10_000)]
        with subprocess.Popen(script, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            try:
                process.wait(seconds if poses is None else None)
            except subprocess.TimeoutExpired:
                process.kill()
        measured = mbcacq.load_observations(folder).n_poses if list(folder.glob("*.rrd")) else 0
        return process.returncode == -signal.SIGKILL, measured

    def resumed(self, folder: Path) -> dict:
        """What a resumed investigation has in common with this one; to begin with, whether it can be resumed."""
        resumed = list(mbcacq.investigate(None, resume=folder, dry_run=True))
        again = mbcacq.load_observations(folder)
        same = {name: np.array_equal(getattr(again, name), getattr(self.observed, name)) for name in COMPARED_EXACTLY}
        differs = [
            {name: (value, b[name]) for name, value in a.items() if value != b[name]}
            for a, b in zip(map(fields_as_json, resumed), map(fields_as_json, self.decided), strict=False)
        ]
        decisions = len(resumed) == len(self.decided) and not any(differs)
        return {"decisions": decisions, "differs": differs, **same, "calibration": figures_of(again) == self.calibrated}


def figures_of(obs: Observations) -> str:
    """All figures of the calibration of a recording, with every digit."""
    return json.dumps(mbcacq.calibrate(obs).to_dict(), sort_keys=True)


def kills(given: argparse.Namespace) -> None:
    """Killed after a random number of poses, and, every second time, at a random moment."""
    table, rng = Table(f"kills-{given.seed}"), np.random.default_rng(given.seed)
    with tempfile.TemporaryDirectory() as made:
        whole = Undisturbed(Path(made))
        for k in range(given.count):
            poses, share = int(rng.integers(1, whole.observed.n_poses + 1)), float(rng.uniform(0.2, 1.0))
            if k in table.done:
                continue
            folder = Path(made) / f"killed{k}"
            in_time, measured = whole.killed(folder, None if k % 2 else poses, share * whole.seconds)
            row = {"by": "moment" if k % 2 else "poses", "killed": in_time, "measured": measured}
            begun = (folder / INVESTIGATION_FILE).exists()  # else nothing was measured, and there is nothing to resume
            table.add_numbered(k, row | (whole.resumed(folder) if begun else {"begun": False}))
