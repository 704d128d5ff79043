"""Mistakes that people make in plan, artefact, robot and data: each is answered by one sentence that names the cause and the cure."""

from collections.abc import Callable
from pathlib import Path

import pytest
from plan_folder import Folder

import mbcacq
from mbcacq.errors import MbcacqError
from mbcacq.exports.certificate import read_certificate_file
from mbcacq.exports.result_json import load_result
from mbcacq.model.robot_import import import_robot
from mbcacq.plan import load
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.feasibility import check
from mbcacq.recording import load_observations

Sentences = list[str]


def refused(act: Callable[..., object], *arguments, **named) -> Sentences:
    """The sentence with which something is refused."""
    with pytest.raises(MbcacqError) as caught:
        act(*arguments, **named)
    return [str(caught.value)]


def plan(*changes: tuple[str, str]):
    """A plan that cannot be read."""
    return lambda path: refused(load, Folder(path).plan(*changes))


def findings(*changes: tuple[str, str]):
    """A plan that can be read, and what ``plan check`` says about it."""

    def act(path: Path) -> Sentences:
        loaded = load(Folder(path).plan(*changes))
        return [str(f) for f in check(loaded, expand_reachable(loaded)[0]) if f.level != "info"]

    return act


def file(name: str, *changes: tuple[str, str]):
    """A robot or artefact file that cannot be meant."""

    def act(path: Path) -> Sentences:
        folder = Folder(path)
        folder.change(name, *changes)
        return refused(load, folder.plan())

    return act


def square(path: Path) -> Sentences:
    """Four balls in the corners of a square."""
    folder = Folder(path)
    corners = ((0, 0), (60, 0), (60, 60), (0, 60))
    rows = "".join(f"  - {{id: {k}, centre_mm: [{x}, {y}, 0], diameter_mm: 12}}\n" for k, (x, y) in enumerate(corners, 1))
    folder.write("mbc.yaml", "id: mbc\nname: square\nballs:\n" + rows)
    loaded = load(folder.plan())
    return [str(f) for f in check(loaded, expand_reachable(loaded)[0]) if f.code == "symmetric"]


def new_plan(arm: str, artefact: str):
    """``plan new`` with what it cannot take."""

    def act(path: Path) -> Sentences:
        for name in {arm, artefact} & {"arm.urdf", "balls.csv"}:
            (path / name).write_text("")
        arm_file, artefact_file = (path / n if "." in n else n for n in (arm, artefact))
        return refused(mbcacq.new_plan, arm_file, "gocator-3210", artefact_file, path / "new.yaml")

    return act


def certificate(text: str, name: str = "certificate.csv"):
    def act(path: Path) -> Sentences:
        (path / name).write_text(text)
        return refused(read_certificate_file, path / name, "mbc")

    return act


LIMIT = '<limit lower="-3" upper="3" velocity="2" effort="1"/>'
URDF = (
    '<robot name="arm">'
    + "".join(f'<link name="{n}"/>' for n in ("base_link", "one", "two", "tool0"))
    + '<joint name="a" type="revolute"><parent link="base_link"/><child link="one"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>'
    + LIMIT
    + '</joint><joint name="b" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>'
    + LIMIT
    + '</joint><joint name="c" type="fixed"><parent link="two"/><child link="tool0"/><origin xyz="0.3 0 0"/></joint></robot>'
)


def robot(text: str, name: str = "arm.urdf", **options):
    """A description of an arm that ``robot import`` refuses."""

    def act(path: Path) -> Sentences:
        (path / name).write_text(text)
        return refused(import_robot, path / name, **options)

    return act


CELL = """\
format: mbcacq-observation-set/1
robot:
  name: two axes
  links:
    - {theta_deg: 0, d_mm: 100, a_mm: 0, alpha_deg: 90}
    - {theta_deg: 0, d_mm: 0, a_mm: 300, alpha_deg: 0}
hand_eye: {translation_mm: [0, 0, 200]}
artefacts: [{id: mbc, balls: [{id: 1, centre_mm: [0, 0, 0], diameter_mm: 12}, {id: 2, centre_mm: [30, 0, 5], diameter_mm: 12}]}]
stations: [{id: table, artefact: mbc}]
"""
SET = {
    "cell.yaml": CELL,
    "poses.csv": "pose,station,q1_deg,q2_deg\n1,table,0.5,-90.5\n2,table,10.5,-80\n",
    "centres.csv": "pose,ball,x_mm,y_mm,z_mm\n1,1,1.5,2,3\n2,2,4,5,6\n",
}


def data(name: str, old: str, new: str):
    """An observation set with one slip in one of its files."""

    def act(path: Path) -> Sentences:
        for each, text in SET.items():
            assert each != name or old in text
            (path / each).write_text(text.replace(old, new) if each == name else text)
        return refused(load_observations, path)

    return act


def without(name: str):
    def act(path: Path) -> Sentences:
        for each, text in SET.items():
            if each != name:
                (path / each).write_text(text)
        return refused(load_observations, path)

    return act


def plan_from(name: str, text: str):
    """A file of something else in the place of a plan."""

    def act(path: Path) -> Sentences:
        (path / name).write_text(text)
        return refused(load, path / name)

    return act


def swapped(path: Path) -> Sentences:
    folder = Folder(path)
    for name in ("robot", "mbc"):
        (folder.path / f"{name}.yaml").rename(path / f"{name}.old")
    (path / "robot.old").rename(folder.path / "mbc.yaml")
    (path / "mbc.old").rename(folder.path / "robot.yaml")
    return refused(load, folder.plan())


def plan_for_result(path: Path) -> Sentences:
    return refused(load_result, Folder(path).plan())


def workbook(path: Path) -> Sentences:
    for name, text in SET.items():
        (path / name.replace("poses.csv", "poses.xlsx")).write_text(text)
    return refused(load_observations, path)


def in_radians(path: Path) -> Sentences:
    poses = "".join(f"{k},table,{0.1 * k},{-0.3 * k}\n" for k in range(1, 5))
    centres = "".join(f"{k},{b},{k},{b},3\n" for k in range(1, 5) for b in (1, 2))
    three = CELL.replace("{id: 2, ", "{id: 3, centre_mm: [0, 20, 0], diameter_mm: 12}, {id: 2, ")
    for name, text in {
        "cell.yaml": three,
        "poses.csv": "pose,station,q1_deg,q2_deg\n" + poses,
        "centres.csv": "pose,ball,x_mm,y_mm,z_mm\n" + centres + "1,3,1,2,3\n",
    }.items():
        (path / name).write_text(text)
    return refused(mbcacq.calibrate, path)


TABLE = "obstacles:\n  - {name: table, min_mm: [300, -500, 0], max_mm: [900, 500, 500]}\nartefacts: ["
POST = "obstacles:\n  - {name: post, min_mm: [450, -50, 500], max_mm: [650, 50, 1100]}\nartefacts: ["

MISTAKES = {  # what was done: how, words of the cause, words of the cure
    "a key misspelt": (plan(("  driver: kuka_rsi", "  driver: kuka_rsi\n  sped: 0.3")), "unknown key 'sped'", "correct or remove it"),
    "a robot file for a plan": (lambda path: refused(load, Folder(path).path / "robot.yaml"), "this is no plan", "give a plan, or add that line"),
    "a URDF for a robot file": (new_plan("arm.urdf", "mbc-8"), "not such a description", "make one: mbcacq robot import"),
    "a certificate for an artefact file": (new_plan("panda", "balls.csv"), "not a certificate", "make one: mbcacq export"),
    "a robot's name misspelt": (new_plan("kr6-r900", "mbc-8"), "among the tool's robots none of that name", "did you mean kr6_r900"),
    "a key forgotten": (plan(("  driver: kuka_rsi\n", "")), "robot lacks 'driver'", "add it"),
    "a word for a number": (plan(("tilt_deg: 20", "tilt_deg: steep")), "should be a valid number, not 'steep'", "correct it"),
    "a number in quotes": (plan(("tilt_deg: 20", "tilt_deg: '20'")), "should be a valid number, not '20'", "correct it"),
    "a tilt beyond the horizontal": (plan(("tilt_deg: 20", "tilt_deg: 95")), "should be less than 90", "correct it"),
    "indented with a tab": (plan(("  driver: kuka_rsi", "\tdriver: kuka_rsi")), "not valid YAML", "indent with spaces"),
    "a bracket left open": (plan(("[mbc.yaml, bar.yaml]", "[mbc.yaml, bar.yaml")), "not valid YAML", "correct this line or the one before"),
    "a place of two numbers": (plan(("[600, 0, 100]", "[600, 0]")), "has too few values", "add the missing ones"),
    "a key written twice": (plan(("name: small\n", "name: small\nname: big\n")), "a second time (first in line 2)", "remove one"),
    "a robot file elsewhere": (plan(("model: robot.yaml", "model: r/robot.yaml")), "there is no robot file", "correct the path (it is relative"),
    "home in radians": (plan(("[0, -90, 90, 0, 90, 0]", "[0, -1.57, 1.57, 0, 1.57, 0]")), "looks like radians", "give them in degrees"),
    "home beyond a limit": (plan(("-90, 90, 0, 90, 0]", "-90, 170, 0, 90, 0]")), "exceeds the limits of A3", "choose another"),
    "five angles for six axes": (plan(("90, 0, 90, 0]", "90, 0, 90]")), "5 joint angles are given", "give one for each axis"),
    "a station in metres": (plan(("[600, 0, 150]", "[0.6, 0, 0.15]")), "looks like metres", "give translation_mm in mm"),
    "the hand-eye transform in metres": (plan(("[1, -0.5, 265]", "[0.001, 0, 0.265]")), "looks like metres", "give translation_mm in mm"),
    "a left-handed rotation": (plan(("[0, 0, -1]]", "[0, 0, 1]]")), "this is no rotation", "right-handed); correct it"),
    "a station of an artefact that is not there": (plan(("artefact: bar", "artefact: bat")), "does not have (it has mbc, bar)", "name one"),
    "a step at a station that is not there": (plan(("    stations: [1]", "    stations: [7]")), "does not have (it has 1, 2)", "add the station"),
    "two stations of one name": (plan(("{id: 2", "{id: 1")), "station '1' exists already", "give each station an id of its own"),
    "near and far exchanged": (plan(("z_mm: 55, far_z_mm: -55", "z_mm: -55, far_z_mm: 55")), "near_z_mm must exceed far_z_mm", "exchange them"),
    "a station out of reach": (findings(("[600, 0, 150]", "[1600, 0, 150]")), "no joint position within the limits", "move the station"),
    "the scanner in the table": (findings(("artefacts: [", TABLE)), "into table", "change the view, or move the station"),
    "home inside a post": (findings(("artefacts: [", POST)), "at home", "choose another home position"),
    "the artefact beside the view": (findings(("azimuth_deg: 30}", "azimuth_deg: 30, shift_mm: [0, 0, 80]}")), "0 of 8 balls", "change view"),
    "calibrating with a bar alone": (findings(("stations: [1]", "stations: [2]")), "leaves its orientation open", "with three balls or more"),
    "a jerk beyond the arm's": (findings(("  driver: kuka_rsi", "  driver: kuka_rsi\n  jerk_time_s: 0.001")), "its limit is", "raise jerk_time_s"),
    "diameters in metres": (file("mbc.yaml", ("diameter_mm: 12.0", "diameter_mm: 0.012")), "outside 1 to 500 mm", "give it in mm"),
    "a ball number twice": (file("mbc.yaml", ("id: 2,", "id: 1,")), "ball 1 exists already", "number the balls of a cell once"),
    "the same ball number on the bar": (file("bar.yaml", ("id: 9,", "id: 3,")), "exists already in artefact 'mbc'", "number the balls"),
    "balls inside each other": (file("mbc.yaml", ("diameter_mm: 12.0", "diameter_mm: 80.0")), "overlap", "correct centre_mm or diameter_mm"),
    "a symmetric artefact": (square, "looks the same turned", "make all distances between its balls differ"),
    "a certificate without diameters": (certificate("label,x,y,z\nB1,0,0,0\n"), "column d_mm is missing", "add it"),
    "a certificate as PDF": (certificate("%PDF-1.7", "certificate.pdf"), "must be .csv, .yaml or DMIS output (.dmo), not '.pdf'", "convert it"),
    "a certificate in metres": (certificate("label,x,y,z,d\nB1,0,0,0,0.012\nB2,0.06,0,0,0.012\n"), "looks like metres or inches", "in mm"),
    "a certificate in inches": (certificate("label,x,y,z,d\nB1,0,0,0,0.47\nB2,2.4,0,0,0.47\n"), "looks like metres or inches", "in mm"),
    "a URDF for a plan": (plan_from("arm.urdf", URDF), "this is XML, where a plan", "robot import makes a robot file"),
    "a certificate for a plan": (plan_from("balls.csv", "label,x,y\nB1,0,0\n"), "this is no plan", "write it as lines of 'key: value'"),
    "a robot file and an artefact file exchanged": (swapped, "this is an artefact file, where a robot file is needed", "name the right file"),
    "a plan for a result": (plan_for_result, "is a plan, nothing was measured yet", "then give the folder of the run"),
    "limits the wrong way round": (file("robot.yaml", ("[-170, 170]", "[170, -170]")), "limits of A1", "exchange them"),
    "an axis without speed": (file("robot.yaml", (", speed_deg_s: 300", "")), "A1 has no speed_deg_s", "give it for every axis"),
    "a length of a link without its unit": (file("robot.yaml", ("d_mm: 400", "d: 400")), "links[0] lacks 'd_mm'", "add it"),
    "a URDF with another flange": (robot(URDF, flange="flange"), "has no link 'flange'", "its links are base_link, one, two, tool0"),
    "a URDF that is still xacro": (robot(URDF.replace("0 0 0.4", "0 0 ${h}")), "should be 3 numbers", "is it a xacro file?"),
    "a planar joint in the URDF": (robot(URDF.replace("revolute", "planar", 1), base="base_link"), "is planar", "name its --base and --flange"),
    "an SDF for a URDF": (robot(URDF.replace("robot", "sdf")), "begins with <sdf>", "give a .urdf, .xacro or MJCF file"),
    "DH rows without their convention": (robot("theta_deg,d_mm,a_mm,alpha_deg\n", "rows.csv"), "which convention", "say --convention"),
    "DH rows without units": (
        robot("theta,d_mm,a_mm,alpha_deg\n0,1,2,3\n0,1,2,3\n", "rows.csv", convention="standard"), "column theta_deg is missing", "name it so if it is in deg",
    ),
    "decimal commas between commas": (data("poses.csv", "0.5,-90.5", "0,5,-90,5"), "the row has 6 cells, the header 4", "and semicolon"),
    "a column forgotten": (data("poses.csv", "q2_deg", "second"), "column q2_deg is missing", "add it"),
    "an empty cell": (data("poses.csv", "10.5", ""), "the cell is empty", "fill it in"),
    "n/a for a number": (data("centres.csv", "1.5", "n/a"), "'n/a' is not a number", "correct it"),
    "a pose number twice": (data("poses.csv", "2,table,10.5", "1,table,10.5"), "pose 1 appears twice", "number each pose once"),
    "a station that cell.yaml does not have": (data("poses.csv", "2,table", "2,floor"), "'floor' is not in cell.yaml", "correct it"),
    "a ball that is on no artefact": (data("centres.csv", "2,2,4", "2,3,4"), "ball 3 is on no artefact", "correct it"),
    "a centre of no pose": (data("centres.csv", "2,2,4", "9,2,4"), "pose 9 is not in poses.csv", "correct it"),
    "a misspelt key in cell.yaml": (data("cell.yaml", "stations", "station"), "'station' is not known", "'stations' is meant? correct it"),
    "an artefact that cell.yaml does not have": (data("cell.yaml", "artefact: mbc", "artefact: bar"), "not among: mbc", "name one of these"),
    "no measured points": (without("centres.csv"), "neither centres.csv nor a folder scans", "add one of them"),
    "a workbook for a CSV": (workbook, "cannot be read", "save poses.xlsx as CSV"),
    "angles in radians": (in_radians, "they look like radians", "in degrees"),
    "a folder of something else": (lambda path: refused(load_observations, path), "is not a recording", "give a run folder"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_typical_mistake_is_answered_by_cause_and_cure(mistake, tmp_path):
    make, cause, cure = MISTAKES[mistake]
    sentences = make(tmp_path)
    answered = [s for s in sentences if cause in s]
    assert answered, sentences
    assert cure in answered[0].split(cause, 1)[1], answered[0]
    assert "\n" not in answered[0]


def test_the_artefacts_of_the_tool_have_no_symmetry_and_a_chiral_one_neither():
    from mbcacq.model import shipped
    from mbcacq.plan.plausibility import symmetric

    for path in sorted((shipped.folder() / "artefacts").glob("*.yaml")):
        assert symmetric(read_certificate_file(path, "a").artefact) == "", path
    import numpy as np

    from mbcacq.model.cell import Artefact

    mirrored = np.array([[0, 0, 0], [50, 0, 0], [10, 40, 0], [10, 0, 40.0]])  # a mirror image of itself, and no rotation makes it good
    assert symmetric(Artefact("m", "m", (1, 2, 3, 4), mirrored, np.full(4, 12.0))) == ""
    assert "ball 2 could be ball 3" in symmetric(
        Artefact("p", "p", (1, 2, 3), np.array([[0, 0, 0], [30, 0, 0], [0, 30, 0.0]]), np.full(3, 6.0))
    )
