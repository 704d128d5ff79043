"""A cell whose arm and scanner are only simulated, without protocols: its runs take seconds."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

import yaml

import mbcacq
from mbcacq.acquisition import events

PLANS = Path(__file__).parents[2] / "plans"
BUDGET = mbcacq.Budget(poses=30)


def simulated_plan(folder: Path, name: str, **changes: Any) -> Path:
    """A shipped plan without the poses that judge, fast, with noise that a pose has whenever it is measured."""
    plan = yaml.safe_load((PLANS / name).read_text(encoding="utf-8"))
    plan["robot"] |= {"driver": "simulated", "options": {}, "model": str(PLANS / plan["robot"]["model"]), "speed": 1.0, "settle_s": 0.05}
    plan["scanner"] |= {"driver": "simulated", "options": {}, "scan_time_s": 0.05}
    plan["artefacts"] = [str(PLANS / artefact) for artefact in plan["artefacts"]]
    plan["steps"] = [step for step in plan["steps"] if step["phase"] != "verification"]
    plan["fake"] = {**plan.get("fake", {}), "draws": "pose", "pitch_mm": 1.0}
    path = folder / "plan.yaml"
    path.write_text(yaml.safe_dump({**plan, **changes}), encoding="utf-8")
    return path


def killed_after(poses: int):
    """A subscriber that kills this process as kill -9 does, once so many poses were measured."""
    done = []

    def subscriber(event: events.Event) -> None:
        if isinstance(event, events.PoseDone):
            done.append(event)
            if len(done) == poses:
                os.kill(os.getpid(), signal.SIGKILL)

    return subscriber


if __name__ == "__main__":  # PLAN FOLDER POSES: killed after so many
    plan, folder, count = sys.argv[1:]
    operator = mbcacq.Operator(subscribers=(killed_after(int(count)),))
    list(mbcacq.investigate(plan, BUDGET, out=folder, dry_run=True, operator=operator))
