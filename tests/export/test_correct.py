"""Corrected programs: the calibrated arm with its effects reaches the nominal places; everything else of the file stays."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.cli.app import app
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.effects.functions import DescribedPart, cosine, linear, sine
from mbcacq.effects.learnt_range import learnt_ranges
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.model.cell import RobotModel
from mbcacq.workflow.correct import correct

DEG = np.pi / 180
PROGRAM = (
    "&ACCESS RVP\r\nDEFDAT weld\r\n"
    "DECL E6AXIS XP1={A1 10.0,A2 -80.0,A3 70.0,A4 15.0,A5 40.0,A6 -5.0,E1 0.0,E2 0.0}\r\n"
    "; DECL E6AXIS XOLD={A1 1,A2 2,A3 3,A4 4,A5 5,A6 6}\r\n"
    "DECL E6POS XP2={X 900.0,Y 0.0,Z 1000.0,A 0.0,B 90.0,C 0.0,S 2,T 2}\r\n"
    "DECL FDAT FP1={TOOL_NO 1,BASE_NO 0}\r\nXP3={a1 -30,a2 -100,a3 95,a4 0.5,a5 25,a6 90}\r\nENDDAT\r\n"
)


def arm() -> RobotModel:
    chain = Chain(
        np.array([-1.0, 1, 1, -1, 1, -1]),
        np.array([0, 0, -90, 0, 0, 180]) * DEG,
        np.array([450.0, 0, 0, 660, 0, 80]),
        np.array([150.0, 610, 20, 0, 0, 0]),
        np.array([-90, 0, -90, 90, -90, 180]) * DEG,
        np.zeros(6),
    )
    limits = np.array([[-170, 170], [-185, 65], [-137, 163], [-185, 185], [-120, 120], [-350, 350]]) * DEG
    com = np.array([[0.0, 0, 0], [-240, 0, 0], [0, 0, 120], [0, 200, 0], [0, 0, 0], [0, 0, -20]])
    return RobotModel("test arm", chain, limits, np.array([0, 38, 24, 9, 5, 0.5]), com, payload_mass=3.0)


def result() -> dict:
    """The content of a result.json of an arm with errors, an elastic A2 and a wavy A4."""
    robot = arm()
    model = EffectModel(robot)
    here = Covariates(model.poses(np.random.default_rng(0).uniform(-1, 1, (30, 6))))
    soft = [DescribedPart("joint", 1, 0, (linear("gravity_torque_2"),))]
    wavy = [DescribedPart("joint", 3, 0, (sine("q4", 3.0), cosine("q4", 3.0)))]

    def one(name, where, on, parts, values):
        k = len(values)
        names, many = tuple(f"{name}[{j}]" for j in range(k)), np.full(k, 1e-9)
        return EffectTerm(
            name=name,
            where=(where,),
            depends_on=on,
            parts=tuple(parts),
            names=names,
            units=("rad",) * k,
            coefficients=np.array(values),
            std=many,
            sigma=many,
            typical=many,
            ranges=learnt_ranges(here, parts),
        )

    terms = (
        one("joint_compliance", "A2", "gravity_torque_2", soft, [3e-6]),
        one("gear_transmission_error", "A4", "q4", wavy, [4e-4, 1e-4]),
    )
    errors = np.random.default_rng(1).normal(0, [1e-3, 0.3, 0.3, 1e-3, 1e-3], (6, 5))
    rows = {
        w: {p: getattr(c, p).tolist() for p in PARAMETERS}
        for w, c in (("nominal", robot.chain), ("calibrated", robot.chain.with_errors(errors)))
    }
    rows["errors"] = {p: errors[:, i].tolist() for i, p in enumerate(PARAMETERS)}
    return {
        "format": "mbcacq-result/1",
        "method": "ml",
        "fit": {"poses": 1, "centres": 1, "rms_mm": 0.0, "chi2": 0.0, "dof": 0, "rank": 0},
        "robot": {"name": robot.name, "sign": robot.chain.sign.tolist(), "limits": robot.limits.tolist(), **rows},
        "T_flange_scanner": np.eye(4).tolist(),
        "preliminary": {"T_flange_scanner": np.eye(4).tolist()},
        "stations": [],
        "balls": [],
        "parameters": [],
        "names": [],
        "covariance": [],
        "noise": {"scanner_mm": [0.01] * 3, "joint_rad": [1e-5] * 6},
        "effects": replace(model, terms=terms).to_dict(),
    }


def goals_of(angles_deg) -> np.ndarray:
    return arm().chain.flange(np.radians(np.atleast_2d(angles_deg)))


def test_a_krl_program_is_corrected_and_nothing_else_changes(tmp_path):
    program = tmp_path / "weld.dat"
    program.write_bytes(PROGRAM.encode("latin-1"))
    done = correct(program, result())
    text = done.file.read_bytes().decode("latin-1")
    assert done.file.name == "weld_corrected.dat"
    assert [p.name for p in done.points] == ["XP1", "XP3"]
    assert all(p.reached for p in done.points)
    assert min(p.before_mm for p in done.points) > 0.1
    old, new = PROGRAM.splitlines(), text.splitlines()
    assert [i for i, (a, b) in enumerate(zip(old, new, strict=True)) if a != b] == [2, 6]
    assert new[2].endswith(",E1 0.0,E2 0.0}")
    assert text.count("\r\n") == PROGRAM.count("\r\n")


def test_points_that_do_not_say_all_joints_are_listed(tmp_path):
    program = tmp_path / "weld.src"
    program.write_text(PROGRAM.replace("ENDDAT", "PTP XP1\r\nPTP XP3 C_PTP") + "PTP {A1 12.5}\n$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}\n")
    (tmp_path / "result.json").write_text(json.dumps(result()))
    done = correct(program, result())
    assert [(name, line) for name, line, _ in done.left_alone] == [("XP2", 5), ("line 10", 10)]
    assert [one["line"] for one in done.to_dict()["left_alone"]] == [5, 10]
    shown = CliRunner().invoke(app, ["correct", str(program), "--with", str(tmp_path / "result.json"), "--force"]).stdout
    assert "2 of 2 points corrected" in shown
    assert "2 more points are not corrected" in shown
    assert "XP2 (line 5): is a pose" in shown
    assert "line 10: has not the angles of all axes" in shown


def test_the_corrected_angles_reach_the_nominal_places(tmp_path):
    program = tmp_path / "points.csv"
    q = np.random.default_rng(3).uniform([-90, -120, 40, -100, 20, -90], [90, -40, 110, 100, 90, 90], (40, 6))
    lines = ["name,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg", *(f"p{i}," + ",".join(f"{v:.9f}" for v in row) for i, row in enumerate(q))]
    program.write_text("\n".join(lines) + "\n")
    done = correct(program, result(), tmp_path / "out.csv")
    written = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True, encoding="utf-8", dtype=None)
    corrected = np.stack([written[f"corrected_q{i}_deg"] for i in range(1, 7)], axis=1)
    there = CalibratedCell.from_dict(result()).frames(np.radians(corrected))[:, -1]
    assert np.abs(there - goals_of(q))[:, :3, 3].max() < 5e-5  # six decimals of a degree
    assert np.abs(there - goals_of(q))[:, :3, :3].max() < 1e-7
    assert max(p.residual_mm for p in done.points) < 1e-3


def test_poses_without_angles_find_some(tmp_path):
    program = tmp_path / "poses.csv"
    xyz, abc = se3.to_abc(goals_of([20, -80, 70, 30, 40, -50]))
    near = ",".join(repr(float(v)) for v in (*xyz[0], *np.degrees(abc[0])))
    program.write_text(f"x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n{near}\n5000,0,0,0,0,0\n")
    done = correct(program, result())
    assert [p.reached for p in done.points] == [True, False]
    content = json.loads(json.dumps(done.to_dict()))
    assert content["points"][1]["reason"]
    assert content["points"][1]["residual_mm"] > 1000
    last = (tmp_path / "poses_corrected.csv").read_text().splitlines()[-1]
    assert last.split(",")[6:12] == [""] * 6
    assert ",false," in last


def test_a_point_that_is_programmed_beyond_a_limit_stays_although_a_turn_back_is_within(tmp_path):
    program = tmp_path / "turned.src"
    program.write_text("PTP {A1 10,A2 -80,A3 70,A4 15,A5 40,A6 -5}\nPTP {A1 500,A2 -80,A3 70,A4 15,A5 40,A6 -5}\n")
    done = correct(program, result())
    assert [point.reached for point in done.points] == [True, False]
    assert done.points[1].reason == "A1 is programmed beyond its limits"
    assert "{A1 500,A2 -80" in done.file.read_text()


def test_a_point_at_a_limit_stays_as_programmed(tmp_path):
    program = tmp_path / "edge.src"
    program.write_text("PTP {A1 170.0,A2 -80,A3 70,A4 15,A5 40,A6 -5}\n")
    broken = result()
    broken["robot"]["calibrated"]["theta"][0] = 0.05 * -1  # the arm stands behind its zero: A1 would have to go beyond its limit
    program_text = program.read_text()
    done = correct(program, broken)
    if done.points[0].reached:  # the offset went the other way: mirror it
        broken["robot"]["calibrated"]["theta"][0] = 0.05
        done = correct(program, broken, force=True)
    assert not done.points[0].reached
    assert "A1" in done.points[0].reason
    assert done.file.read_text() == program_text


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.dat", "DECL E6POS X={X 1,Y 2,Z 3,A 0,B 0,C 0}", "no absolute target with all 6 joint angles"),
        ("a.csv", "a,b\n1,2\n", "neither q1_deg"),
        ("a.csv", "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n1,2,3,4,5,x\n", "a.csv:2"),
        ("a.csv", "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n1,2,3,4,5,nan\n", "not a finite number"),
        ("a.txt", "", "give a robot program"),
    ],
)
def test_a_file_without_points_is_refused_with_its_line(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=words):
        correct(tmp_path / name, result())


def test_an_existing_file_is_not_overwritten(tmp_path):
    (tmp_path / "weld.dat").write_text(PROGRAM)
    (tmp_path / "weld_corrected.dat").write_text("mine")
    with pytest.raises(ConfigError, match="exists"):
        correct(tmp_path / "weld.dat", result())
    with pytest.raises(ConfigError, match="itself"):
        correct(tmp_path / "weld.dat", result(), tmp_path / "weld.dat", force=True)


def table(header, *rows):
    return "\n".join([header, *rows]) + "\n"


SIX = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg"


@pytest.mark.parametrize(
    "data",
    [
        table(SIX, "10,-80.5,70,15,40,-5").encode(),
        table(SIX.replace(",", ";"), "10;-80,5;70;15;40;-5").encode("cp1252"),
        table(SIX.replace(",", "\t"), "10\t-80,5\t70\t15\t40\t-5").replace("\n", "\r\n").encode("utf-16"),
        table(SIX, "10,-80.5,70,15,40,-5").encode("utf-8-sig"),
        table(SIX.replace("_deg", " [deg]"), "10,-80.5,70,15,40,-5").encode(),
        table(SIX.replace("_deg", "_rad"), ",".join(repr(float(np.radians(v))) for v in (10, -80.5, 70, 15, 40, -5))).encode(),
        table("A1,A2,A3,A4,A5,A6", "10,-80.5,70,15,40,-5").encode(),
        table(SIX, "10,-80.5,70,15,40,-5").replace("\n", "\r").encode(),
        ("sep=;\n" + table(SIX.replace(",", ";"), "10;-80,5;70;15;40;-5")).encode(),
    ],
    ids=["plain", "German", "UTF-16", "BOM", "brackets", "radians", "axes", "carriage returns", "Excel's sep"],
)
def test_tables_are_read_and_written_in_their_own_form(tmp_path, data):
    (tmp_path / "p.csv").write_bytes(data)
    done = correct(tmp_path / "p.csv", result())
    (tmp_path / "q.csv").write_text(table(SIX, "10,-80.5,70,15,40,-5"))
    assert done.points[0].q_deg == pytest.approx(correct(tmp_path / "q.csv", result()).points[0].q_deg, abs=1e-7)
    again = done.file.read_bytes()
    assert again.startswith(data[: len(data) // 2 // 2 * 2 // 4])
    encoding = "utf-16" if data[:2] == b"\xff\xfe" else "utf-8-sig"
    text = again.decode(encoding)
    assert "corrected_q1_deg" in text
    if "-80,5" in data.decode(encoding):
        assert "." not in text.splitlines()[1 if text[:4] != "sep=" else 2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (table(SIX, "10,-80,5,70,15,40,-5"), "p.csv:2: column q6_deg: the row has 7 cells, the header 6"),
        (table(SIX, "1_0,-80.5,70,15,40,-5"), "p.csv:2: column q1_deg: '1_0' is not a number"),
        (table(SIX.replace(",", ";"), "10;-80,5;70.5;15;40;-5"), "has a point in a file with decimal commas"),
        (table("q1,q2,q3,q4,q5,q6", "0.1745,-1.405,1.2217,0.2618,0.698,-0.087"), "all joint angles are within 2 pi and q1 says no unit"),
        (table(SIX, "0.1745,-1.405,1.2217,0.2618,0.698,-0.087"), "within 2 pi, which looks like radians; name the columns q1_rad"),
        (table("x,y,z,a,b,c", "1,2,3,4,5,6"), "column x_mm is missing: column x names no unit"),
        (table(SIX, "10,-80.5,70,15,40," + "9" * 400), "is not a finite number"),
        ("a\0b\n1\n", "NUL"),
    ],
)
def test_tables_that_cannot_be_meant_are_refused(tmp_path, text, words):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(ConfigError, match=words):
        correct(tmp_path / "p.csv", result())


@pytest.mark.parametrize(
    ("file", "robot", "language"),
    [("a.src", "Universal Robots UR5e", "KRL"), ("a.mod", "KUKA KR 10 R1100", "RAPID"), ("a.ls", "UR10", "LS"), ("a.script", "ABB IRB 1200", "URScript")],
)  # fmt: skip
def test_a_program_of_another_make_is_refused(file, robot, language, tmp_path):
    program = tmp_path / file
    program.write_text(PROGRAM)
    content = result()
    content["robot"]["name"] = robot
    with pytest.raises(ConfigError, match=f"{language} is the language of .* arms, and this result is of '{robot}'"):
        correct(program, content)
    assert [path.name for path in tmp_path.iterdir()] == [file]


def test_an_arm_that_was_not_calibrated_corrects_nothing(tmp_path):
    path = tmp_path / "a.src"
    path.write_text("PTP {A1 10,A2 -80,A3 80,A4 0,A5 30,A6 0}\n")
    nominal = result()
    nominal["robot"]["calibrated"] = nominal["robot"]["nominal"]
    nominal["effects"] = None
    with pytest.raises(ConfigError, match="holds the nominal arm"):
        correct(path, nominal)
    assert not (tmp_path / "a_corrected.src").exists()


def test_a_simulated_calibration_corrects_only_when_that_is_said(tmp_path):
    path = tmp_path / "a.src"
    path.write_text("PTP {A1 10,A2 -80,A3 80,A4 0,A5 30,A6 0}\n")
    (tmp_path / "result.json").write_text(json.dumps(result() | {"simulated": True}))
    words = ["correct", str(path), "--with", str(tmp_path / "result.json")]
    refused = CliRunner().invoke(app, words)
    assert refused.exit_code != 0
    assert "this calibration is simulated" in refused.output
    assert CliRunner().invoke(app, [*words, "--simulated-anyway"]).exit_code == 0
