"""The numbers that tune planning are those of the plan in hand, not constants of the modules."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.plan import LoadedPlan, expand, load
from mbcacq.plan.clearance import Clearance
from mbcacq.plan.feasibility import check

PLANS = Path(__file__).parents[2] / "plans"


def with_planning(loaded: LoadedPlan, **changes: Any) -> LoadedPlan:
    return replace(loaded, planning=replace(loaded.planning, **changes))


def test_a_wider_margin_to_the_limits_gives_more_warnings():
    loaded = load(PLANS / "quick.yaml")
    poses = expand(loaded)
    strict = with_planning(loaded, near_limit=float(np.radians(60.0)))
    assert not [f for f in check(loaded, poses) if f.code == "near-limit"]
    assert [f for f in check(strict, poses) if f.code == "near-limit"]


def test_thicker_links_leave_less_clearance():
    loaded = load(PLANS / "quick.yaml")
    home = np.radians(loaded.plan.robot.home_deg)
    thick = with_planning(loaded, link_radius_shares=tuple(1.1 * share for share in loaded.planning.link_radius_shares))
    assert Clearance(thick).at(home, "p1").distance < Clearance(loaded).at(home, "p1").distance
