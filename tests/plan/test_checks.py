"""Each kind of finding, provoked once; the shipped plans give none."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from plan_folder import PLANS

from mbcacq.cli.plan import command
from mbcacq.errors import ConfigError
from mbcacq.plan import expand, load, path, refuse_errors
from mbcacq.plan.clearance import Clearance
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.feasibility import check
from mbcacq.plan.occlusion import occluded
from mbcacq.plan.routing import find_paths, path_home
from mbcacq.plan.timing import motion_time


def findings(plan_path):
    loaded = load(plan_path)
    return check(loaded, expand_reachable(loaded)[0])


def codes(plan_path, level="error"):
    return {f.code for f in findings(plan_path) if f.level == level}


def taught(folder, *poses, extra=""):
    text = folder.plan().read_text().split("steps:")[0]
    rows = ", ".join(str(list(p)) for p in poses)
    return folder.write(
        "plan.yaml", f"{text}{extra}steps:\n  - {{name: t, phase: position, do: joints, station: 1, poses_deg: [{rows}]}}\n"
    )


GOOD = (0, -66, 122, 0, 24, 90)


@pytest.mark.parametrize("name", ["kuka.yaml", "kuka-effects.yaml", "quick.yaml"])
def test_shipped_plans_have_no_errors_and_no_warnings(name):
    loaded = load(PLANS / name)
    poses = expand(loaded)
    assert [str(f) for f in check(loaded, poses) if f.level != "info"] == []
    refuse_errors(loaded, poses)


def test_the_plan_with_lift_and_thermometers_has_no_errors():
    loaded = load(PLANS / "kuka-lift.yaml")
    assert [str(f) for f in check(loaded, expand(loaded)) if f.level == "error"] == []
    assert loaded.plan.positioner.driver == "modbus"
    assert {name for s in loaded.plan.sensors for name in s.options["units"]} == {"robot_C", "scanner_C", "air_C"}


def test_small_plan_is_clean(folder):
    assert codes(folder.plan()) == set()


def test_out_of_reach(folder):
    found = [f for f in findings(folder.plan(("[600, 0, 150]", "[1600, 0, 150]"))) if f.code == "reach"]
    assert [f.place for f in found] == [f"{folder.path}/plan.yaml:{line}" for line in (24, 25)]
    assert all("step 'views'" in f.sentence for f in found)


ADDRESS = ("  driver: gocator\n", "  driver: gocator\n  options: {address: 192.168.1.10}\n")  # a line more


def test_check_of_a_plan_without_a_reachable_pose(folder):
    far = folder.plan(ADDRESS, ("[600, 0, 150]", "[2600, 0, 150]"), ("[600, 0, 100]", "[2600, 0, 100]"))
    done = CliRunner().invoke(command, ["check", str(far)])
    assert done.exit_code == 2, done.exception
    assert "plan.yaml:25: step 'views'" in done.output
    assert "0 poses" in done.output
    found = json.loads(CliRunner().invoke(command, ["check", str(far), "--json"]).output)
    assert {f["code"] for f in found["findings"]} == {"reach", "move-station"}


def test_calibrating_with_two_balls_only_is_refused(folder):
    """The bar alone in the phase 'position'; beside an artefact of three balls and more it may take part."""
    bar = ("    stations: [1]", "    stations: [2]")
    found = [f for f in findings(folder.plan(bar)) if f.code == "few-balls"]
    assert [(f.level, f.place) for f in found] == [("error", f"{folder.path}/plan.yaml:19")]
    assert "step 'views' calibrates with artefact 'bar', which has 2 balls" in found[0].sentence
    with pytest.raises(ConfigError, match="three balls or more"):
        refuse_errors(load(folder.path / "plan.yaml"), [])
    assert "few-balls" not in codes(folder.plan(("phase: verification", "phase: position")))


def test_calibrating_with_balls_on_one_line_is_refused(folder):
    third = "  - {id: 11, centre_mm: [0, 0, 0], diameter_mm: 25.0}\n"
    (folder.path / "bar.yaml").write_text((folder.path / "bar.yaml").read_text() + third)
    found = [f for f in findings(folder.plan(("    stations: [1]", "    stations: [2]"))) if f.code == "few-balls"]
    assert "has its balls on one line" in found[0].sentence


def test_taught_poses_in_degrees_of_small_size_are_no_radians(folder):
    assert load(taught(folder, (0, -5, 5, 0, 2.5, 0)))
    with pytest.raises(ConfigError, match="looks like radians"):
        load(taught(folder, (0, -1.152, 2.129, 0, 0.419, 1.571)))


def test_taught_pose_beyond_a_limit_and_close_to_one(folder):
    found = {f.code: f for f in findings(taught(folder, (0, -90, 157, 0, 60, 0), (0, -90, 155, 0, 60, 0)))}
    assert found["limits"].level == "error"
    assert "A3 at 157.0° exceeds its limits -120..156°" in found["limits"].sentence
    assert found["near-limit"].level == "warning"


def test_singular_postures(folder):
    assert "wrist-singular" in codes(taught(folder, (0, -66, 122, 10, 2, 0)), "warning")
    assert "elbow-singular" in codes(taught(folder, (0, -30, 3, 0, 60, 0)), "warning")
    # the upper arm leans back by 20 deg, the forearm forward until the wrist (behind four rows) stands on axis 1
    postures = np.array([[0, -110, a, 0, 60, 0] for a in np.arange(20, 150, 0.25)])
    wrist = load(folder.path / "plan.yaml").cell.robot.chain.frames(np.radians(postures))[:, 4, 0, 3]
    assert "shoulder-singular" in codes(taught(folder, postures[np.argmin(np.abs(wrist))].tolist()), "warning")


def test_balls_outside_the_view(folder):
    found = findings(folder.plan(("{tilt_deg: 20, azimuth_deg: 30}", "{tilt_deg: 20, azimuth_deg: 30, shift_mm: [0, 0, 80]}")))
    assert [(f.level, f.code) for f in found if f.step == "views"][0] == ("error", "out-of-view")
    assert "0 of 8 balls are in view, fewer than the 3 that are needed" in found[0].sentence
    part = folder.plan(("{tilt_deg: 20, azimuth_deg: 30}", "{tilt_deg: 20, azimuth_deg: 30, shift_mm: [15, 0, 0]}"))
    assert "part-view" in codes(part, "info")
    assert "out-of-view" not in codes(part)


def test_expected_ball_outside_the_field_of_view(folder):
    text = folder.plan().read_text().split("steps:")[0]
    steps = (
        f"steps:\n  - {{name: t, phase: position, do: joints, station: 1, balls: [1, 2], poses_deg: [{list(GOOD[:5])[:4] + [60, 0]}]}}\n"
    )
    found = [f for f in findings(folder.write("plan.yaml", text + steps)) if f.code == "out-of-view"]
    assert found
    assert "outside the field of view" in found[0].sentence


def test_looking_at_the_edge_of_the_artefact(folder):
    assert "steep" in codes(folder.plan(("tilt_deg: 20", "tilt_deg: 80"), ("[600, 0, 150]", "[600, 0, 350]")), "warning")


def test_one_ball_before_another():
    """Camera about 245 mm above the origin of this view; two balls on one ray, a third aside."""
    field = load(PLANS / "quick.yaml").plan.scanner.field_of_view
    xyz = np.array([[0, 0, 0], [0.5, 0, 20], [30, 0, 0.0]])
    assert occluded(xyz, np.full(3, 6.0), field, 0.6) == [(1, 0)]
    assert occluded(np.array([[0, 0, 0], [14.0, 0, 20]]), np.full(2, 6.0), field, 0.6) == []


def test_scanner_in_the_table(folder):
    table = ("artefacts: [", "obstacles:\n  - {name: table, min_mm: [300, -500, 0], max_mm: [900, 500, 500]}\nartefacts: [")
    found = [f for f in findings(folder.plan(table)) if f.code == "collision"]
    assert found
    assert any("scanner runs" in f.sentence and "into table" in f.sentence for f in found)
    with pytest.raises(ConfigError, match=r"plan\.yaml:\d+: .*table.*\(\d+ more: mbcacq plan check"):
        refuse_errors(load(folder.path / "plan.yaml"), expand(load(folder.path / "plan.yaml")))


def test_home_inside_something(folder):
    box = ("artefacts: [", "obstacles:\n  - {name: post, min_mm: [450, -50, 500], max_mm: [650, 50, 1100]}\nartefacts: [")
    assert any("at home" in f.sentence for f in findings(folder.plan(box)))


def test_scanner_against_its_own_forearm(folder):
    assert any(
        "link" in f.sentence for f in findings(taught(folder, (0, -90, 90, 0, 119, 0), extra="clearance_mm: 60\n")) if f.code == "collision"
    )


def test_same_pose_twice(folder):
    assert "repeated" in codes(taught(folder, GOOD, (0, -66, 122, 0, 24.001, 90)), "warning")


def test_an_artefact_put_back_by_hand(folder):
    """Station 1, the bar, station 3 with the same artefact as 1, and back to 1; the untouched bar may be looked at again."""
    third = ("  - {id: 2,", "  - {id: 3, artefact: mbc, pose_in_base: {translation_mm: [600, 100, 150]}}\n  - {id: 2,")
    again = ("  - name: ends", "  - {name: again, phase: position, do: look, stations: [3, 1], views: [{tilt_deg: 15}]}\n  - name: ends")
    found = [f for f in findings(folder.plan(third, again)) if f.code == "revisited"]
    assert [f.step for f in found] == ["again"]
    assert "at station '1'" in found[0].sentence
    motorised = ("hand_eye:", "positioner: {driver: modbus}\nhand_eye:")
    assert "revisited" not in codes(folder.plan(third, again, motorised), "warning")
    untouched = ("    stations: [2]", "    stations: [2, 1, 2]")
    assert "revisited" not in codes(folder.plan(untouched), "warning")


SIDES = (
    "{id: 1, artefact: mbc, pose_in_base: {translation_mm: [600, 0, 150], abc_deg: [20, -10, 5]}}",
    "{id: 1, artefact: mbc, pose_in_base: {translation_mm: [600, 0, 150], abc_deg: [0, 0, 0]}}",
)


def test_a_path_around_an_obstacle_is_found_and_is_free(folder):
    """A screen stands between two views, higher than the straight motion passes: the arm must go round or over it."""
    home = ("home_deg: [0, -90, 90, 0, 90, 0]", "home_deg: [60, -110, 110, 0, 90, 0]")
    views = (
        ("{tilt_deg: 20, azimuth_deg: 30}", "{tilt_deg: 45, azimuth_deg: 90}"),
        ("{tilt_deg: 30, azimuth_deg: 200, roll_deg: 40}", "{tilt_deg: 45, azimuth_deg: 270}"),
    )
    loaded = load(
        folder.plan(
            ("artefacts: [", "obstacles:\n  - {name: screen, min_mm: [560, -15, 330], max_mm: [640, 15, 420]}\nartefacts: ["),
            SIDES,
            home,
            *views,
        )
    )
    poses = expand(loaded)
    clearance = Clearance(loaded)
    assert clearance.along_segment(poses[0].q, poses[1].q, "1", 10.0) is not None
    transits, blocked = find_paths(loaded, poses)
    assert blocked == []
    assert len(transits[1]) > 0
    stops = [poses[0].q, *transits[1], poses[1].q]
    for a, b in zip(stops, stops[1:], strict=False):
        for share in np.linspace(0, 1, 200):
            assert clearance.at(a + share * (b - a), "1").distance > 5.0


def test_a_pose_without_a_free_path_is_an_error_with_its_line(folder):
    cage = "  - {name: screen, min_mm: [330, 330, -200], max_mm: [350, 1100, 1800]}\n"
    turned = (
        "{id: 1, artefact: mbc, pose_in_base: {translation_mm: [600, 0, 150], abc_deg: [20, -10, 5]}}",
        "{id: 1, artefact: mbc, pose_in_base: {translation_mm: [0, 600, 150], abc_deg: [0, 0, 0]}}",
    )
    found = [f for f in findings(folder.plan(("artefacts: [", f"obstacles:\n{cage}artefacts: ["), turned)) if f.code == "way"]
    assert found
    assert "no free path to pose 0 was found" in found[0].sentence
    assert found[0].place.endswith("plan.yaml:26")
    loaded = load(folder.path / "plan.yaml")
    poses = expand(loaded)
    with pytest.raises(ConfigError, match="no free path"):
        path(loaded, poses[:1])


def test_no_motion_is_called_free_where_fine_sampling_finds_contact():
    """Random motions past a post: bounded halving against sampling every hundredth of the motion."""
    loaded = load(PLANS / "kuka.yaml")
    clearance, rng = Clearance(loaded), np.random.default_rng(8)
    disagreements = hits = 0
    for _ in range(40):
        a, b = np.radians(rng.uniform([-40, -60, 60, -180, -100, -180], [40, 0, 140, 180, 100, 180], (2, 6)))
        finest = min(clearance.at(a + s * (b - a), "p1").distance for s in np.linspace(0, 1, 101))
        free = clearance.along_segment(a, b, "p1", 10.0) is None
        hits += finest < 10
        disagreements += free and finest < 10 - 4
    assert hits > 10
    assert disagreements == 0


def test_the_artefact_is_moved_while_the_arm_is_at_home():
    loaded = load(PLANS / "kuka.yaml")
    poses = expand(loaded)
    home = np.radians(loaded.plan.robot.home_deg)
    for before, pose, transit in zip(poses, poses[1:], path(loaded, poses)[1:], strict=False):
        if before.station == pose.station:
            assert transit.retract == []
        else:
            assert transit.retract[-1] == pytest.approx(home)
    assert path_home(loaded, poses[-1])[-1] == pytest.approx(home)


def test_a_resumed_run_starts_from_home_and_keeps_to_the_poses_left():
    loaded = load(PLANS / "kuka.yaml")
    poses = expand(loaded)
    done = frozenset(range(15)) | {17}
    whole, left = path(loaded, poses), path(loaded, poses, done)
    assert len(left) == len(poses)
    assert all(len(left[k]) == 0 for k in done)
    assert left[15].retract == []  # the arm comes from home, not from pose 14
    assert [len(t) for t in left[19:]] == [len(t) for t in whole[19:]]


def test_motion_time_of_a_long_and_a_short_move():
    """Trapezoid with jerk: s/v + v/a + a/j, where the top speed is reached."""
    from mbcacq.devices import MotionLimits

    limits = MotionLimits(np.array([1.0, 2.0]), np.array([5.0, 5.0]), np.array([50.0, 50.0]))
    assert motion_time(np.zeros(2), np.array([2.0, 0.1]), limits) == pytest.approx(2.0 + 0.2 + 0.1)
    assert motion_time(np.zeros(2), np.zeros(2), limits) == 0


def test_a_drawn_plan_holds_the_arm_at_its_poses(folder):
    """Read back from the file: the scanner's last place is that of the last pose, each station stands where it was planned."""
    from rerun.chunk import RrdReader

    plan, file = folder.plan(), folder.path / "plan.rrd"
    assert CliRunner().invoke(command, ["show", str(plan), "--rrd", str(file)]).exit_code == 0
    loaded = load(plan)
    entities = {str(chunk.entity_path) for chunk in RrdReader(str(file)).stream().to_chunks()}
    assert {"/world/robot/link1", "/world/robot/scanner", "/world/stations/1", "/world/stations/2", "/log"} <= entities
    places = [chunk.to_record_batch() for chunk in RrdReader(str(file)).stream().filter(content="/world/robot/scanner").to_chunks()]
    moved = [b for b in places if "Transform3D:translation" in b.schema.names]
    last = max(moved, key=lambda b: np.array(b.column("time").cast("int64")).max()).column("Transform3D:translation").to_pylist()[-1][0]
    expected = (loaded.cell.robot.chain.flange(expand(loaded)[-1].q[None])[0] @ loaded.cell.T_flange_scanner)[:3, 3]
    assert last == pytest.approx(expected, abs=0.01)


def test_command_line(folder):
    good = folder.plan(ADDRESS)
    shown = CliRunner().invoke(command, ["show", str(good), "--json"])
    content = json.loads(shown.output)
    assert [p["balls"] for p in content["poses"]][2:] == [[9], [10]]
    assert content["duration"]["station_changes"] == 1
    assert CliRunner().invoke(command, ["check", str(good)]).exit_code == 0
    bad = folder.plan(ADDRESS, ("[600, 0, 150]", "[1600, 0, 150]"))
    failed = CliRunner().invoke(command, ["check", str(bad)])
    assert failed.exit_code == 2
    assert "plan.yaml:25: step 'views'" in failed.output
    failed = json.loads(CliRunner().invoke(command, ["check", str(bad), "--json"]).output)
    assert failed["errors"] == 2
    assert failed["findings"][0]["code"] == "reach"


def test_a_last_pose_that_no_free_path_leaves_is_an_error_of_the_check_too(folder, monkeypatch):
    """The run examines the way home before anything moves; the check of the plan says it earlier, with the line."""
    from mbcacq.plan.routing import Router

    plan = folder.plan()
    retract = Router.retract
    monkeypatch.setattr(Router, "retract", lambda self, pose: None if pose.number == 3 else retract(self, pose))
    found = [f for f in findings(plan) if f.code == "way"]
    assert [(f.place, f.poses) for f in found] == [(f"{folder.path}/plan.yaml:31", (3,))]
    assert "no free path home from pose 3 was found" in found[0].sentence
    loaded = load(plan)
    with pytest.raises(ConfigError, match="no free path home from pose 3"):
        path(loaded, expand(loaded))
