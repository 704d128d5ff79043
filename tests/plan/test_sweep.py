"""Before anything moves, every segment is examined: limits, workspace, clearance, between the poses as well as at them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from mbcacq.errors import ConfigError, SafetyStop
from mbcacq.plan import Transit, expand, load, path
from mbcacq.plan.clearance import Clearance
from mbcacq.plan.feasibility import check
from mbcacq.plan.motion_preview import refuse_unsafe, segments, swept
from mbcacq.plan.routing import path_home

PLANS = Path(__file__).parents[2] / "plans"


def planned(folder, **changes):
    plan = yaml.safe_load((PLANS / "quick.yaml").read_text())
    plan["robot"]["model"] = str(PLANS / plan["robot"]["model"])
    plan["artefacts"] = [str(PLANS / a) for a in plan["artefacts"]]
    plan |= changes
    file = folder / "plan.yaml"
    file.write_text(yaml.safe_dump(plan))
    return load(file)


def motions(loaded, done=frozenset()):
    poses = expand(loaded)
    left = [p for p in poses if p.number not in done]
    return list(segments(loaded, poses, path(loaded, poses, done), path_home(loaded, left[-1]), done))


def test_the_segments_lead_without_a_break_from_home_to_home(tmp_path):
    loaded = planned(tmp_path)
    home = np.radians(loaded.plan.robot.home_deg)
    for done in (frozenset(), frozenset({0, 1, 2}), frozenset({0, 4, 9})):
        found = motions(loaded, done)
        np.testing.assert_array_equal(found[0].start, home)
        np.testing.assert_array_equal(found[-1].end, home)
        for a, b in zip(found, found[1:], strict=False):
            np.testing.assert_array_equal(a.end, b.start)
        refuse_unsafe(loaded, found)


def test_a_resumed_run_approaches_its_first_pose_from_the_pose_before_it(tmp_path):
    """A gear with play arrives from the same side as in an undisturbed run."""
    loaded = planned(tmp_path)
    poses = expand(loaded)
    whole, resumed = path(loaded, poses), path(loaded, poses, frozenset({0, 1, 2}))
    waypoints = list(resumed[3])
    last = [k for k, q in enumerate(waypoints) if np.array_equal(q, poses[2].q)]
    assert last
    np.testing.assert_array_equal(np.array(waypoints[last[0] + 1 :]).reshape(-1, 6), np.array(list(whole[3])).reshape(-1, 6))
    assert not any(len(resumed[k]) for k in (0, 1, 2))


@pytest.mark.parametrize(("axis", "side"), [(0, "min_mm"), (0, "max_mm"), (2, "max_mm"), (1, "min_mm")])
def test_no_body_of_the_arm_leaves_the_workspace(tmp_path, axis, side):
    wide = {"min_mm": [-900.0, -900.0, -300.0], "max_mm": [1500.0, 900.0, 1700.0]}
    loaded = planned(tmp_path, workspace=wide)
    refuse_unsafe(loaded, motions(loaded))
    box = swept(loaded, motions(loaded))
    middle = (box.low[axis] + box.high[axis]) / 2
    wide[side][axis] = float(middle)
    narrow = planned(tmp_path, workspace=wide)
    errors = [f for f in check(narrow, expand(narrow)) if f.level == "error"]
    assert any("the workspace's" in str(f) for f in errors)
    with pytest.raises(SafetyStop, match="the workspace's .* limit"):
        refuse_unsafe(narrow, motions(planned(tmp_path)))  # the motions of the same plan without its fence


def test_a_thin_rod_between_two_free_poses_is_found(tmp_path):
    """Sampled at the poses alone nothing is wrong; the straight motion between them goes through it."""
    loaded = planned(tmp_path)
    poses = expand(loaded)
    a, b = poses[4].q, poses[9].q
    chain, clearance = loaded.cell.robot.chain, Clearance(loaded)
    middle = chain.flange(((a + b) / 2)[None])[0] @ loaded.cell.T_flange_scanner @ np.array([0.0, 0, 240.0, 1])
    rod = [{"name": "rod", "min_mm": (middle[:3] - 4).tolist(), "max_mm": (middle[:3] + 4).tolist()}]
    fenced = planned(tmp_path, obstacles=rod, clearance_mm=1.0)
    assert Clearance(fenced).at(a, "p1").distance > 1
    assert Clearance(fenced).at(b, "p1").distance > 1
    assert clearance.along_segment(a, b, None, 1.0) is None
    bare = [p for p in poses if p.number in (4, 9)]
    straight = list(segments(fenced, bare, [Transit(), Transit()], [], frozenset()))[1:]
    with pytest.raises(SafetyStop, match=r"on the way to pose 9 .* come within .* of (rod|scanner|link)"):
        refuse_unsafe(fenced, straight)


def test_link_1_is_kept_off_what_stands_beside_the_base(tmp_path):
    """A shoulder that reaches out: between axis 1 and the upper arm, link 1 alone comes by."""
    robot = {"model": str(PLANS / "robots/kr120_r2700_2.yaml"), "home_deg": [0, -90, 90, 0, 0, 0], "link_radius_mm": 60}
    post = {"name": "post", "min_mm": [-5, 160, 640], "max_mm": [5, 170, 650]}
    fenced = planned(tmp_path, robot=yaml.safe_load((PLANS / "quick.yaml").read_text())["robot"] | robot, obstacles=[post])
    clearance, posture = Clearance(fenced), np.radians([0.0, -90, 90, 0, 0, 0])
    start, end = (posture + np.radians([angle, 0, 0, 0, 0, 0]) for angle in (-60, -120))
    assert min(clearance.at(q, None).distance for q in (start, end)) > 10
    near = clearance.along_segment(start, end, None, 10.0)
    assert near is not None
    assert (near.a, near.b) == ("post", "link 1")


def test_a_waypoint_beyond_a_joint_limit_is_refused(tmp_path):
    loaded = planned(tmp_path)
    found = motions(loaded)
    low = loaded.cell.robot.limits[4, 0]
    bent = found[3].end.copy()
    bent[4] = low - 1e-3
    with pytest.raises(SafetyStop, match="A5 would reach -120.1°, outside its limits"):
        refuse_unsafe(loaded, [*found[:3], replace(found[3], end=bent)])


def test_the_swept_box_holds_every_pose_and_its_speed_is_the_scanners(tmp_path):
    loaded = planned(tmp_path)
    box, poses = swept(loaded, motions(loaded)), expand(loaded)
    chain = loaded.cell.robot.chain
    q = np.array([p.q for p in poses])
    for place in ((chain.flange(q))[:, :3, 3], (chain.flange(q) @ loaded.cell.T_flange_scanner)[:, :3, 3]):
        assert (place >= box.low - 1e-9).all()
        assert (place <= box.high + 1e-9).all()
    # axis 1 alone at the plan's speed: a circle about the base's axis
    home = np.radians(loaded.plan.robot.home_deg)
    turned = home + np.radians([40.0, 0, 0, 0, 0, 0])
    segment = replace(motions(loaded)[0], start=home, end=turned)
    radius = np.linalg.norm((chain.flange(home[None])[0] @ loaded.cell.T_flange_scanner)[:2, 3])
    assert loaded.cell.robot.speed is not None
    expected = radius * loaded.plan.robot.speed * loaded.cell.robot.speed[0]
    assert swept(loaded, [segment]).speed_mm_s == pytest.approx(expected, rel=1e-3)


def test_what_carries_the_scanner_is_a_body_too(tmp_path):
    """Housing far from the flange: the bracket between them must not pass through anything either."""
    loaded = planned(tmp_path)
    view = loaded.plan.scanner.field_of_view
    small = view.model_copy(update={"body_mm": ((-20.0, -20.0, 60.0), (20.0, 20.0, 100.0))})
    plan = loaded.plan.model_copy(update={"scanner": loaded.plan.scanner.model_copy(update={"field_of_view": small})})
    home = np.radians(loaded.plan.robot.home_deg)
    flange = loaded.cell.robot.chain.flange(home[None])[0]
    beside = (flange @ np.array([0.0, 0, 90.0, 1]))[:3] + [0, 45, 0]
    post = yaml.safe_load(f"[{{name: post, min_mm: {(beside - 3).tolist()}, max_mm: {(beside + 3).tolist()}}}]")
    fenced = replace(
        planned(tmp_path, obstacles=post), plan=planned(tmp_path, obstacles=post).plan.model_copy(update={"scanner": plan.scanner})
    )
    near = Clearance(fenced).at(home, None)
    assert {near.a, near.b} == {"post", "bracket"}


def test_a_workspace_turned_inside_out_names_its_line(tmp_path):
    with pytest.raises(ConfigError, match=r"plan\.yaml:\d+: workspace: each number of min_mm must be below that of max_mm"):
        planned(tmp_path, workspace={"min_mm": [0, 0, 0], "max_mm": [1, -1, 1]})
