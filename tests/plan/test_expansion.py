"""Where the scanner is sent: what is aimed at appears where it was asked for, seen from the side that was asked for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plan_folder import PLANS

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.plan import expand, load
from mbcacq.plan.expansion import targets
from mbcacq.plan.field_of_view import T_base_scanner, margin
from mbcacq.plan.schema import FieldOfView, View

ANGLE = st.floats(-180, 180)
views = st.builds(View, tilt_deg=st.floats(0, 80), azimuth_deg=ANGLE, roll_deg=ANGLE, shift_mm=st.tuples(*[st.floats(-30, 30)] * 3))


@given(view=views, abc=st.tuples(*[st.floats(-3, 3)] * 3), point=st.tuples(*[st.floats(-100, 100)] * 3))
def test_the_point_appears_at_the_shift_under_the_tilt(view, abc, point):
    station = se3.from_abc(np.array([600.0, -100, 50]), np.array(abc))
    T_scanner_station = se3.inverse(T_base_scanner(station, np.array(point), view)) @ station
    assert se3.apply(T_scanner_station, np.array(point)) == pytest.approx(view.shift_mm, abs=1e-9)
    axis = T_scanner_station[:3, :3].T @ [0, 0, 1]  # the scanner's z in the station frame
    assert np.degrees(np.arccos(np.clip(axis[2], -1, 1))) == pytest.approx(view.tilt_deg, abs=1e-5)
    if view.tilt_deg > 1:
        off = np.degrees(np.arctan2(axis[1], axis[0])) - view.azimuth_deg
        assert abs((off + 180) % 360 - 180) < 1e-6


def test_roll_turns_the_picture_and_nothing_else():
    station = np.eye(4)
    plain, rolled = (T_base_scanner(station, np.zeros(3), View(tilt_deg=30, azimuth_deg=70, roll_deg=r)) for r in (0, 90))
    assert rolled[:3, 2] == pytest.approx(plain[:3, 2])
    assert rolled[:3, 0] == pytest.approx(plain[:3, 1])
    assert T_base_scanner(station, np.zeros(3), View()) == pytest.approx(np.eye(4))


FIELD = FieldOfView(near_z_mm=50, far_z_mm=-50, near_half_mm=(30, 40), far_half_mm=(50, 80))


def test_margin_of_the_field_of_view_by_hand():
    """At z = 0 the half widths are 40 and 60 mm; the x side is inclined by 20/100, the y side by 40/100."""
    assert margin(FIELD, np.array([0, 0, 49.0])) == pytest.approx(1)
    assert margin(FIELD, np.array([0, 0, -60.0])) == pytest.approx(-10)
    assert margin(FIELD, np.array([39.0, 0, 0])) == pytest.approx(1 / np.sqrt(1.04))
    assert margin(FIELD, np.array([0, -62.0, 0])) == pytest.approx(-2 / np.sqrt(1.16))
    assert margin(FIELD, np.array([0, 0, 49.0]), 6.0) == pytest.approx(-5)


@settings(max_examples=20)
@given(view=views)
def test_balls_with_a_margin_lie_in_the_field_of_view(view):
    T = T_base_scanner(np.eye(4), np.zeros(3), view)
    balls = se3.apply(se3.inverse(T), np.array([[0, 0, 0], [25, 10, 5], [-40, 60, 0.0]]))
    inside = margin(FIELD, balls) >= 0
    depth = (50 - balls[:, 2]) / 100
    half = np.array([30.0, 40]) + depth[:, None] * np.array([20.0, 40])
    assert (inside == ((np.abs(balls[:, :2]) <= half).all(axis=1) & (np.abs(balls[:, 2]) <= 50))).all()


def centres_in_scanner(loaded, pose):
    """Ball centres (B, 3) in the scanner frame at a pose, through the chain."""
    station = next(s for s in loaded.cell.stations if s.id == pose.station)
    scanner = loaded.cell.robot.chain.flange(pose.q[None])[0] @ loaded.cell.T_flange_scanner
    return se3.apply(se3.inverse(scanner) @ station.T_base_station, loaded.cell.artefact(pose.artefact).centres)


@pytest.fixture(scope="module")
def published():
    loaded = load(PLANS / "kuka.yaml")
    return loaded, expand(loaded)


def test_the_published_plan_has_the_poses_of_its_publication(published):
    loaded, poses = published
    count = {phase: sum(p.phase == phase for p in poses) for phase in ("translation", "orientation", "position", "verification")}
    assert count == {"translation": 6, "orientation": 6, "position": 64, "verification": 20}
    assert [p.number for p in poses] == list(range(96))
    assert len({p.station for p in poses if p.phase == "position"}) == 8
    assert len({p.station for p in poses if p.phase == "verification"}) == 10
    lines = loaded.text.splitlines()
    assert all("tilt_deg" in lines[p.line - 1] for p in poses if p.phase in ("orientation", "position"))


def test_every_look_shows_its_aim_where_the_view_puts_it(published):
    loaded, poses = published
    for pose in poses:
        centres = centres_in_scanner(loaded, pose)
        if pose.phase in ("orientation", "position"):
            shift = loaded.plan.steps[pose.step].views[pose.number % 8 - 4 if pose.phase == "position" else pose.number - 6].shift_mm
            assert centres.mean(axis=0) == pytest.approx(shift, abs=1e-6)
        elif pose.phase == "verification":
            assert np.linalg.norm(centres, axis=1).min() < 1e-6
            assert len(pose.balls) == 1


def test_translations_keep_the_orientation_and_go_along_the_base(published):
    loaded, poses = published
    flange = loaded.cell.robot.chain.flange(np.array([p.q for p in poses if p.phase == "translation"]))
    assert np.abs(flange[:, :3, :3] - flange[0, :3, :3]).max() < 1e-9
    moved = flange[:, :3, 3] - flange[:, :3, 3].mean(axis=0)
    assert moved == pytest.approx(np.array(loaded.plan.steps[0].offsets_mm), abs=1e-6)


def test_both_wrist_branches_are_taken_where_asked(published):
    loaded, poses = published
    views = loaded.plan.steps[2].views
    for k, pose in enumerate(p for p in poses if p.phase == "position"):
        assert np.sign(pose.q[4]) == (1 if views[k % 8].wrist == "positive" else -1)


def test_single_balls_of_a_long_artefact(folder):
    one = folder.plan(("balls: each", "balls: [10]"))
    loaded = load(one)
    ends = [p for p in expand(loaded) if p.phase == "verification"]
    assert [p.balls for p in ends] == [(10,)]
    assert centres_in_scanner(loaded, ends[0])[1] == pytest.approx(np.zeros(3), abs=1e-6)
    with pytest.raises(ConfigError, match=r"plan\.yaml:30: step 'ends' expects ball 3, which the artefact at station '2' does not have"):
        load(folder.plan(("balls: each", "balls: [3]")))


def test_an_unreachable_pose_names_step_station_and_line(folder):
    path = folder.plan(("[600, 0, 150]", "[1600, 0, 150]"))
    with pytest.raises(ConfigError) as error:
        expand(load(path))
    assert str(error.value) == (
        f"{path}:24: step 'views' at station '1': no joint position within the limits of KUKA KR 10 R1100-2 reaches this pose; "
        "move the station or change the view"
    )


def test_taught_poses_stay_as_taught_also_for_seven_axes(folder):
    robot = (PLANS / "robots" / "kr10_r1100_2.yaml").read_text()
    last = robot[robot.index("  - {sign: -1, theta_deg: 180") :]
    folder.write("robot.yaml", robot + last)
    text = folder.plan(("0, 90, 0]", "0, 90, 0, 0]")).read_text().split("steps:")[0]
    steps = "steps:\n  - {name: t, phase: position, do: joints, station: 1, balls: [1, 2, 3], poses_deg: [[0, -70, 110, 5, 60, 10, 20], [1, 2, 3, 4, 5, 6, 7]]}\n"
    poses = expand(load(folder.write("plan.yaml", text + steps)))
    assert np.degrees([p.q for p in poses]) == pytest.approx(np.array([[0, -70, 110, 5, 60, 10, 20], [1, 2, 3, 4, 5, 6, 7]]))
    assert poses[0].balls == (1, 2, 3)
    looked = load(folder.plan(("0, 90, 0]", "0, 90, 0, 0]")))
    for pose, target in zip(expand(looked), targets(looked), strict=True):
        assert looked.cell.robot.chain.flange(pose.q[None])[0] == pytest.approx(target.T_base_flange, abs=1e-5)
