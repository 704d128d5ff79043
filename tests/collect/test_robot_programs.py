"""Robot programs: each is one of its language, and brings the arm to the plan's joint angles by the checked routes."""

import numpy as np
import pytest
import yaml
from mbcacq_fakes.cell.program_steps import steps_of
from program_grammars import GRAMMARS, check
from session import content, loaded, program_of, written_plan

from mbcacq.devices import ConfigError
from mbcacq.plan import expand
from mbcacq.plan.controller_joints import from_controller, to_controller
from mbcacq.plan.programs import DIALECTS, Trigger
from mbcacq.plan.routing import path, path_home
from mbcacq.workflow.joint_log import read_joint_log
from mbcacq.workflow.robot_program import robot_program

JOINTS = {"couplings": [{"axis": 3, "of": 2, "factor": -1}], "sign": [1, -1, 1, 1, 1, 1], "offset_deg": [0, 0, 90, 0, 0, 0]}
PULSES = [1489.5, 1365.3, 1297.0, 853.3, 910.2, 455.1]


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    robot = {**content()["robot"], "controller_joints": {**JOINTS, "pulses_per_deg": PULSES}}
    return written_plan(tmp_path_factory.mktemp("plan"), robot=robot)


def visited(plan):
    """(M, n) rad: every stop of a run, and the number of the pose after which each exposure comes."""
    poses = expand(loaded(plan))
    stops, exposures = [np.radians(loaded(plan).plan.robot.home_deg)], []
    for pose, transit in zip(poses, path(loaded(plan), poses), strict=True):
        stops += [*transit, pose.q]
        exposures += [(len(stops), pose.number)] * pose.exposures
    return np.array([*stops, *path_home(loaded(plan), poses[-1])]), exposures


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_program_does_what_the_run_would(plan, tmp_path, dialect):
    """Read back from its text, and the KRL one by running it."""
    folder = program_of(plan, tmp_path / dialect, dialect)
    moves, exposures = [], []
    for kind, value in steps_of(folder, PULSES):
        if kind == "move":
            moves.append(from_controller(loaded(plan), value))
        else:
            exposures.append((len(moves), value))
    stops, wanted = visited(plan)
    assert exposures == wanted
    assert np.array(moves) == pytest.approx(stops, abs=np.radians(2e-3 if dialect == "inform" else 2e-5))  # half a pulse


@pytest.mark.parametrize("dialect", [name for name in DIALECTS if name not in ("krl", "csv")])
@pytest.mark.parametrize("kind", ["output", "pause", "key"])
def test_a_program_is_one_of_its_language(plan, dialect, kind):
    files = robot_program(loaded(plan), dialect, trigger=Trigger(kind))
    checked = [
        check("." + name.rsplit(".", 1)[1].lower(), text)
        for name, text in files.items()
        if name.rsplit(".", 1)[1].lower() in {s[1:] for s in GRAMMARS}
    ]
    assert checked
    assert all(text.isascii() for text in files.values())


def test_the_grammars_refuse_words_of_other_languages(plan):
    text = robot_program(loaded(plan), "rapid")["mbcacq_poses.mod"]
    with pytest.raises(Exception, match="PTP|Unexpected|No terminal"):
        check(".mod", text.replace("MoveAbsJ [[", "PTP {[", 1))


def test_speeds_are_those_of_a_run(plan):
    files = robot_program(loaded(plan), "krl")
    assert "$VEL_AXIS[k]=25" in files["mbcacq_poses.src"]  # robot: speed 0.25
    script = robot_program(loaded(plan), "urscript")["mbcacq_poses.script"]
    slowest = 0.25 * np.min(loaded(plan).cell.robot.speed)
    assert f"mb_v = {slowest:.6f}" in script
    first = next(line for line in robot_program(loaded(plan), "rapid")["mbcacq_poses.mod"].splitlines() if "MoveAbsJ" in line)
    assert "v50, fine" in first  # from where the arm stands nobody knows how far it is
    assert all("Nobody has run this program" in text for name, text in files.items() if name.endswith(".src"))
    assert "NOBODY HAS RUN" in files["README.txt"]


def test_a_program_of_what_is_left(plan):
    done = frozenset(range(10))
    table = robot_program(loaded(plan), "csv", done=done)["poses.csv"].splitlines()
    assert [line.split(",")[1] for line in table[1:]] == [str(k) for k in range(10, 16)]
    with pytest.raises(ConfigError, match="all 16 poses are measured already"):
        robot_program(loaded(plan), "csv", done=frozenset(range(16)))


def test_joints_as_the_controller_counts_them(tmp_path):
    """J3 of a FANUC is counted from the horizontal: J3 = q3 - q2."""
    joints = {"couplings": [{"axis": 3, "of": 2, "factor": -1}]}
    plan = loaded(written_plan(tmp_path, robot={**content()["robot"], "controller_joints": joints}))
    angles = to_controller(plan, np.radians([1.0, 20, 50, 4, 5, 6]))
    assert angles == pytest.approx([1, 20, 30, 4, 5, 6])
    assert np.degrees(from_controller(plan, angles)) == pytest.approx([1, 20, 50, 4, 5, 6])


@pytest.fixture
def on_a_track(tmp_path):
    track = {"name": "E1", "type": "prismatic", "carries": "arm", "direction": [1, 0, 0], "limits_mm": [0, 120], "speed_mm_s": 1000}
    robot = {**content()["robot"], "external_axes": [track], "home_external": [20.0], "spread_axes": ["E1"]}
    return written_plan(tmp_path, robot=robot)


def test_krl_and_tables_move_external_axes(on_a_track, tmp_path):
    """E1 in mm beside A1 to A6 in degrees: read back, and as the controller logs them."""
    poses = expand(loaded(on_a_track))
    assert np.ptp([pose.q[0] for pose in poses]) > 50  # the track takes part
    for dialect in ("krl", "csv"):
        folder = program_of(on_a_track, tmp_path / dialect, dialect)
        moves = [value for kind, value in steps_of(folder, None, ("E1", *(f"A{k}" for k in range(1, 7)))) if kind == "move"]
        q = from_controller(loaded(on_a_track), np.array(moves))
        away = np.abs(q[:, None] - np.array([pose.q for pose in poses])).max(axis=2).min(axis=0)
        assert away.max() < 1e-5
        assert q[0] == pytest.approx(loaded(on_a_track).plan.robot.home)
    text = (tmp_path / "krl" / "mbcacq_poses.src").read_text()
    assert ",E1 20.00000}" in text
    assert "$VEL_EXTAX[k]=25" in text
    log = (tmp_path / "krl" / "mbcacq_poses.dat").read_text()
    for k, pose in enumerate(poses, 1):
        own = ",".join(f"A{i} {a:.5f}" for i, a in enumerate(np.degrees(pose.q[1:]), 1))
        log = log.replace(f"mb_at[{k}]={{A1 0.00000,A2 0.00000,A3 0.00000,A4 0.00000,A5 0.00000,A6 0.00000,E1 0.00000}}",
                          f"mb_at[{k}]={{{own},E1 {pose.q[0]:.5f}}}")  # fmt: skip
    (tmp_path / "back.dat").write_text(log)
    found = read_joint_log(tmp_path / "back.dat", loaded(on_a_track), poses)
    np.testing.assert_allclose([found.q[pose.number] for pose in poses], [pose.q for pose in poses], atol=1e-5)


def test_programs_of_other_makers_move_no_external_axes(on_a_track):
    with pytest.raises(ConfigError, match="programs of ABB are written without external axes, which this plan has; take --for krl or csv"):
        robot_program(loaded(on_a_track), "rapid")


@pytest.mark.parametrize(
    ("joints", "sentence"),
    [
        ({"sign": [1, 1]}, "sign has 2 values for an arm of 6 axes"),
        ({"couplings": [{"axis": 7, "of": 2, "factor": 1}]}, "axis 7 and 2 of an arm with 6"),
        ({"couplings": [{"axis": 3, "of": 2, "factor": 1}, {"axis": 2, "of": 3, "factor": 1}]}, "which cannot be undone"),
        (None, "pulses_per_deg are missing"),
    ],
)
def test_joints_that_do_not_fit_the_arm_are_named(tmp_path, joints, sentence):
    plan = written_plan(tmp_path, robot={**content()["robot"], "controller_joints": joints})
    with pytest.raises(ConfigError, match=f"robot.controller_joints: .*{sentence}"):
        robot_program(loaded(plan), "inform")


def test_a_program_of_fanuc_needs_to_know_how_its_controller_counts(tmp_path):
    plan = written_plan(tmp_path)
    with pytest.raises(ConfigError, match="FANUC count J3 from the horizontal: .*controller_joints"):
        robot_program(loaded(plan), "karel")
    (tmp_path / "other").mkdir()
    as_the_file = written_plan(tmp_path / "other", robot={**content()["robot"], "controller_joints": {}})
    assert "PROGRAM mbcacq_poses" in robot_program(loaded(as_the_file), "karel")["mbcacq_poses.kl"]


def test_abb_moves_with_the_weight_of_the_plan(tmp_path):
    robot = {**content()["robot"], "payload": {"mass_kg": 2.5, "com_mm": [10, 0, 80.5]}}
    module = robot_program(loaded(written_plan(tmp_path, robot=robot)), "rapid")["mbcacq_poses.mod"]
    tool = "PERS tooldata mb_scanner := [TRUE,[[0,0,0],[1,0,0,0]],[2.500,[10.000,0.000,80.500],[1,0,0,0],0,0,0]];"
    assert tool in module
    assert module.count("fine, mb_scanner;") == module.count("MoveAbsJ")


def test_a_language_that_there_is_none_of(plan):
    with pytest.raises(ConfigError, match="there is no language 'karl'"):
        robot_program(loaded(plan), "karl")


def written_log(folder, rows, header, name="log.csv"):
    path = folder / name
    path.write_text(header + "\n" + "\n".join(",".join(f"{v:.6f}" for v in row) for row in rows) + "\n")
    return path


def test_logs_of_the_controller(rehearsed, tmp_path):
    plan = loaded(rehearsed / "plan.yaml")
    poses = expand(plan)
    q = np.degrees([p.q for p in poses]) + 0.01
    names = ",".join(f"A{k}" for k in range(1, 7))
    log = read_joint_log(written_log(tmp_path, q, names), plan, poses)
    assert np.degrees([log.q[k] for k in range(16)]) == pytest.approx(q, abs=1e-5)
    with pytest.raises(ConfigError, match="its angles are in rad, not in deg"):
        read_joint_log(written_log(tmp_path, np.radians(q), names), plan, poses)
    named = names.replace("A", "q").replace(",", "_rad,") + "_rad"
    log = read_joint_log(written_log(tmp_path, np.radians(q), named), plan, poses)
    assert np.degrees(log.q[3]) == pytest.approx(q[3], abs=1e-4)
    with pytest.raises(ConfigError, match="is it the log of another plan"):
        read_joint_log(written_log(tmp_path, q + 30, names), plan, poses)
    with pytest.raises(ConfigError, match="column q1_deg, q2_deg, .* is missing"):
        read_joint_log(written_log(tmp_path, q, "a,b,c,d,e,f"), plan, poses)


def test_the_log_that_a_kuka_keeps(rehearsed, tmp_path):
    plan = loaded(rehearsed / "plan.yaml")
    poses = expand(plan)
    data = robot_program(plan, "krl")["mbcacq_poses.dat"]
    for k, pose in enumerate(poses[:12], 1):  # stopped after the twelfth
        angles = ",".join(f"A{i} {a + 0.004:.4f}" for i, a in enumerate(np.degrees(pose.q), 1))
        zeros = ",".join(f"A{i} 0.00000" for i in range(1, 7))
        data = data.replace(f"mb_at[{k}]={{{zeros}}}", f"mb_at[{k}]={{{angles},E1 0.0}}")
    path = tmp_path / "mbcacq_poses.dat"
    path.write_text(data)
    log = read_joint_log(path, plan, poses)
    assert sorted(log.q) == list(range(12))
    assert np.degrees(log.q[11] - poses[11].q) == pytest.approx(0.004, abs=1e-4)


def test_the_command_writes_the_files(rehearsed, tmp_path):
    from click.testing import CliRunner

    from mbcacq.cli.app import app

    result = CliRunner().invoke(
        app,
        ["plan", "program", str(rehearsed / "plan.yaml"), "--for", "rapid", "--out", str(tmp_path / "p"), "--wait", "key"],
        prog_name="mbcacq",
    )
    assert result.exit_code == 0, result.output
    assert sorted(p.name for p in (tmp_path / "p").iterdir()) == ["README.txt", "mbcacq_poses.mod", "poses.csv"]
    assert yaml.safe_load((rehearsed / "plan.yaml").read_text())["name"] == "quick"
