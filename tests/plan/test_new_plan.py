"""A plan from nothing, and a plan that is out of reach brought back into it."""

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from finished_runs import at_full_speed

from mbcacq.cli.app import app
from mbcacq.cli.plan import command
from mbcacq.design.new_plan import NewPlan, write_new_plan
from mbcacq.design.station_repair import repaired, station_moves
from mbcacq.errors import ConfigError
from mbcacq.model import shipped
from mbcacq.plan import expand, load
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.feasibility import check
from mbcacq.plan.inverse_kinematics import inverse_kinematics

FOUR_BALLS = """\
id: four
balls:
  - {id: 1, centre_mm: [0, 0, 0], diameter_mm: 12.0}
  - {id: 2, centre_mm: [40, 3, 2], diameter_mm: 12.0}
  - {id: 3, centre_mm: [5, 33, -3], diameter_mm: 12.0}
  - {id: 4, centre_mm: [-28, 9, 6], diameter_mm: 12.0}
"""


ARTEFACT = shipped.named_file("artefacts", "mbc-8")
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "plan-from-nothing.md"


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A folder with what the page "A plan from nothing" makes: its artefact, and the plan of its command with fewer poses."""
    folder, text = tmp_path_factory.mktemp("walk"), PAGE.read_text(encoding="utf-8")
    (folder / "four.yaml").write_text(re.search(r"cat > four.yaml <<'END'\n(.*?)END\n", text, re.DOTALL)[1])
    typed = shlex.split(re.search(r"^mbcacq (plan new .*)$", text, re.MULTILINE)[1])
    typed = [str(folder / word) if word in ("four.yaml", "plan.yaml") else word for word in typed]
    done = CliRunner().invoke(app, [*typed, "--stations", "3", "--poses", "10"], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    return folder


def test_a_plan_from_nothing_runs_dry_to_a_calibration(walk):
    plan, run = shutil.copy(walk / "plan.yaml", walk / "once.yaml"), walk / "run"
    at_full_speed(plan)
    done = CliRunner().invoke(app, ["run", str(plan), "--dry-run", "--out", str(run)], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    result = json.loads((run / "result.json").read_text())
    assert result["verification"]["after"]["max_mm"] < result["verification"]["before"]["max_mm"]
    assert (run / "report.html").stat().st_size > 1_000_000


def test_a_new_plan_has_no_errors_and_spreads_its_stations(walk):
    loaded = load(walk / "plan.yaml")
    poses = expand(loaded)
    assert [str(f) for f in check(loaded, poses) if f.level == "error"] == []
    assert sum(p.phase == "position" for p in poses) >= 8
    assert all(len(p.balls) == 4 for p in poses if p.phase == "position")
    places = np.array([s.planned_pose[:3, 3] for s in loaded.cell.stations])
    apart = np.linalg.norm(places[:, None] - places, axis=2)[~np.eye(len(places), dtype=bool)]
    assert apart.min() > 100
    assert {p.station for p in poses if p.phase == "verification"}.isdisjoint({p.station for p in poses if p.phase == "position"})


def test_a_new_plan_needs_balls_that_show_an_orientation(tmp_path):
    artefact = tmp_path / "two.yaml"
    artefact.write_text("\n".join(FOUR_BALLS.splitlines()[:4]) + "\n")
    request = NewPlan(shipped.robot_file("kr6_r900_2"), shipped.named_file("scanners", "gocator-3210"), artefact, tmp_path / "plan.yaml")
    with pytest.raises(ConfigError, match="2 balls leave its orientation open; three at least are needed"):
        list(write_new_plan(request))


def test_a_plan_never_replaces_a_file_that_it_names(tmp_path):
    request = NewPlan(
        shipped.named_file("robots", "panda"), shipped.named_file("scanners", "gocator-3210"), ARTEFACT, tmp_path / "panda.yaml"
    )
    with pytest.raises(ConfigError, match="the name of a file that the plan itself needs"):
        list(write_new_plan(request))
    assert list(tmp_path.iterdir()) == []


def test_an_arm_without_a_closed_form_is_sampled_without_losing_a_target():
    """What is left out to save time are branches of one target, never a target."""
    robot, rng = shipped.robot("panda"), np.random.default_rng(1)
    targets = robot.chain.flange(rng.uniform(robot.limits[:, 0], robot.limits[:, 1], (20, robot.n)))
    for q, target in zip(inverse_kinematics(robot, sampled=True).solutions(targets), targets, strict=True):
        assert len(q)
        np.testing.assert_allclose(robot.chain.flange(q), np.broadcast_to(target, (len(q), 4, 4)), atol=1e-5)


def test_names_that_are_no_file_are_answered_with_the_choices():
    with pytest.raises(ConfigError, match="no file kr99.*kr6_r900_2"):
        shipped.named_file("robots", "kr99")


def test_a_station_out_of_reach_is_told_the_nearest_place_and_moved_there(folder):
    path = folder.plan(("[600, 0, 150]", "[1250, 0, 150]"))
    (move,) = station_moves(load(path))
    assert (move.station, move.unreachable, move.views) == ("1", 1, 2)
    assert move.place is not None
    assert move.place[0] < 1250
    assert f"{move.distance_mm:.0f} mm away; `--fix` writes it" in move.sentence()
    done = CliRunner().invoke(command, ["check", str(path), "--quick", "--fix"], catch_exceptions=False)
    assert "station '1' was moved by" in done.stderr
    again = load(path)
    assert again.cell.station("1").planned_pose[:3, 3] == pytest.approx(move.place)
    assert expand_reachable(again)[1] == []


def test_a_station_is_not_moved_to_where_the_scanner_is_at_the_forearm(folder):
    """The nearest place in reach of these views puts the scanner beside link 4, closer than the plan allows."""
    path = folder.plan(("[600, 0, 150]", "[1250, 0, 150]"), ("{tilt_deg: 20, azimuth_deg: 30}", "{tilt_deg: 30, azimuth_deg: 0}"))
    fixed, _ = repaired(load(path))
    assert [str(f) for f in check(fixed, expand(fixed)) if f.level == "error"] == []


def test_a_view_that_no_place_helps_is_left_out_and_the_others_stay(folder):
    """An orientation that a wrist limited to one sign cannot take anywhere near, beside one that it can."""
    folder.change("robot.yaml", ("limits_deg: [-120, 120]", "limits_deg: [10, 120]"))
    path = folder.plan(
        ("{tilt_deg: 30, azimuth_deg: 200, roll_deg: 40}", "{tilt_deg: 30, azimuth_deg: 200, roll_deg: 40, wrist: negative}")
    )
    fixed, said = repaired(load(path))
    assert len(fixed.plan.steps[0].views) == 1
    assert "1 views that cannot be reached were left out" in said[-1]
    assert expand_reachable(fixed)[1] == []


def test_an_arm_on_a_track_is_planned_all_along_it_and_judged_at_both_ends(tmp_path):
    out = tmp_path / "plan.yaml"
    made = ["plan", "new", "--robot", "kr10_r1100_2", "--scanner", "gocator-3210", "--artefact", "mbc-8", "--out", str(out)]
    done = CliRunner().invoke(app, [*made, "--track", "0:3000", "--stations", "3", "--poses", "8"], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    loaded = load(out)
    poses = expand(loaded)
    along = {s.id: s.planned_pose[0, 3] for s in loaded.cell.stations}
    assert min(along, key=along.get) == "v1"
    assert max(along, key=along.get) == "v2"
    assert along["v2"] - along["v1"] > 2000
    assert np.ptp([pose.q[0] for pose in poses]) > 1500  # mm: the track comes first in the chain
    for wrong in ("3000:0", "0", "a:b", "0:1e9"):
        assert "is no track" in CliRunner().invoke(app, [*made, "--track", wrong]).stderr
