"""The first motion of a run is examined too: nobody knows where the arm was left."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from mbcacq.errors import SafetyStop
from mbcacq.plan import load
from mbcacq.plan.routing import check_start

PLANS = Path(__file__).parents[2] / "plans"


def plan_with_pillars(folder):
    plan = yaml.safe_load((PLANS / "quick.yaml").read_text())
    plan["robot"]["model"] = str(PLANS / plan["robot"]["model"])
    plan["artefacts"] = [str(PLANS / a) for a in plan["artefacts"]]
    plan["obstacles"] = [
        {"name": f"pillar {side}", "min_mm": [300, low, 300], "max_mm": [600, high, 1200]}
        for side, low, high in (("left", 300, 600), ("right", -600, -300))
    ]
    path = folder / "plan.yaml"
    path.write_text(yaml.safe_dump(plan))
    return load(path)


@pytest.mark.parametrize("side", [90.0, -90.0])
def test_a_start_with_a_pillar_between_the_arm_and_home_is_refused(tmp_path, side):
    loaded = plan_with_pillars(tmp_path)
    home = np.radians(loaded.plan.robot.home_deg)
    check_start(loaded, home)
    turned = home + np.radians([side, 0, 0, 0, 0, 0])
    with pytest.raises(SafetyStop, match="pillar"):
        check_start(loaded, turned)


def test_the_same_start_is_free_without_the_pillars():
    loaded = load(PLANS / "quick.yaml")
    home = np.radians(loaded.plan.robot.home_deg)
    check_start(loaded, home + np.radians([90.0, 0, 0, 0, 0, 0]))
