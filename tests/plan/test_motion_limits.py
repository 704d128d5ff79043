"""Nothing moves without limits, or beyond them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from mbcacq.devices import MotionLimits
from mbcacq.errors import ConfigError
from mbcacq.plan import expand, load
from mbcacq.plan.axis_extremes import axis_extremes
from mbcacq.plan.feasibility import check_motion_limits, refuse_errors
from mbcacq.plan.motion_limits import axis_limits, motion_limits
from mbcacq.plan.routing import find_paths
from mbcacq.plan.timing import motion_time

PLANS = Path(__file__).parents[2] / "plans"


def changed(tmp_path, robot=None, link=None):
    """quick.yaml with other keys of the robot's use, or of its second link (None removes a key)."""
    plan = yaml.safe_load((PLANS / "quick.yaml").read_text(encoding="utf-8"))
    model = yaml.safe_load((PLANS / plan["robot"]["model"]).read_text(encoding="utf-8"))
    for key, value in (link or {}).items():
        model["links"][1].pop(key, None)
        if value is not None:
            model["links"][1][key] = value
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(model), encoding="utf-8")
    plan["robot"] |= {"model": "arm.yaml", **(robot or {})}
    plan["artefacts"] = [str((PLANS / name).resolve()) for name in plan["artefacts"]]
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(plan), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", sorted(p.name for p in PLANS.glob("*.yaml")))
def test_the_plans_that_come_with_the_program_stay_within_the_limits(name):
    assert not list(check_motion_limits(load(PLANS / name)))


@pytest.mark.parametrize(
    ("robot", "words"),
    [
        ({"acceleration_time_s": 0.001}, r"acceleration of \d+ °/s², its limit is \d+; raise acceleration_time_s"),
        ({"jerk_time_s": 0.0001}, r"jerk of \d+ °/s³, its limit is \d+; raise jerk_time_s"),
    ],
)
def test_more_than_the_arm_allows_is_refused_and_never_commanded(tmp_path, robot, words):
    loaded = load(changed(tmp_path, robot))
    with pytest.raises(ConfigError, match=words):
        refuse_errors(loaded, expand(loaded))
    limits, allowed = motion_limits(loaded), axis_limits(loaded)
    assert np.all(limits.acceleration <= allowed.acceleration)
    assert np.all(limits.jerk <= allowed.jerk)


@pytest.mark.parametrize("key", ["limits_deg", "speed_deg_s"])
def test_an_arm_without_limits_does_not_load_for_a_plan(tmp_path, key):
    with pytest.raises(ConfigError, match=f"A2 has no {key}"):
        load(changed(tmp_path, link={key: None}))


@pytest.mark.parametrize(("key", "value"), [("acceleration_deg_s2", 500.0), ("jerk_deg_s3", 5000.0)])
def test_a_limit_stated_for_one_axis_only_is_refused(tmp_path, key, value):
    with pytest.raises(ConfigError, match=f"A1 has no {key}"):
        load(changed(tmp_path, link={key: value}))


def test_stated_limits_take_the_place_of_derived_ones():
    loaded = load(PLANS / "quick.yaml")
    slow = replace(loaded.cell.robot, acceleration=np.full(6, 0.5), jerk=np.full(6, 2.0))
    slowed = replace(loaded, cell=replace(loaded.cell, robot=slow))
    assert [f.code for f in check_motion_limits(slowed)] == ["motion-limits"] * 2
    np.testing.assert_array_equal(motion_limits(slowed).acceleration, slow.acceleration)
    np.testing.assert_array_equal(motion_limits(slowed).jerk, slow.jerk)


def test_the_largest_values_of_each_axis_are_those_of_the_motions():
    loaded = load(PLANS / "quick.yaml")
    poses = expand(loaded)
    transits, _ = find_paths(loaded, poses)
    limits = motion_limits(loaded)
    rows = axis_extremes(loaded, poses, transits)
    assert [row.axis for row in rows] == [1, 2, 3, 4, 5, 6]
    for k, row in enumerate(rows):
        assert 0 < row.speed <= np.degrees(limits.speed[k]) * (1 + 1e-9)
        assert 0 < row.acceleration <= np.degrees(limits.acceleration[k]) * (1 + 1e-9)
        assert 0 < row.jerk <= np.degrees(limits.jerk[k]) * (1 + 1e-6)
    # the slowest axis of a long motion takes the whole of what the plan asks for
    assert max(row.acceleration / np.degrees(limits.acceleration[k]) for k, row in enumerate(rows)) > 0.95
    assert max(row.jerk / np.degrees(limits.jerk[k]) for k, row in enumerate(rows)) > 0.95


@pytest.mark.parametrize("speed", [1e-4, 1e-7, 1e-12])
def test_a_motion_that_would_take_hours_is_refused_by_a_sentence(speed):
    limits = MotionLimits(np.full(6, speed), np.full(6, speed / 0.3), np.full(6, speed / 0.03))
    with pytest.raises(ConfigError, match="set robot: speed higher"):
        motion_time(np.zeros(6), np.ones(6), limits)
