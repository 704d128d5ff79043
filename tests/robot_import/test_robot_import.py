"""Arms from URDF, xacro, MJCF and tables of DH rows: the same arm, its limits and its masses, whatever the file."""

import json

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.gravity import gravity_torque
from mbcacq.model import shipped
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.robot_import import import_robot

LIMIT = '<limit lower="-3" upper="2.5" velocity="2" effort="1"/>'


def joint(name, parent, child, origin, axis="", kind="revolute"):
    limit = LIMIT if kind == "revolute" else ""
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin {origin}/>{axis and f"<axis xyz={axis!r}/>"}{limit}</joint>'


URDF = (
    '<?xml version="1.0"?>\n<robot name="two arms wide">'
    + "".join(f'<link name="{n}"/>' for n in ("world", "foot", "flange"))
    + '<link name="one"><inertial><origin xyz="0 0 0.1"/><mass value="4"/></inertial></link>'
    + '<link name="two"><inertial><origin xyz="0.1 0 0"/><mass value="2"/></inertial></link>'
    + '<link name="cap"><inertial><origin xyz="0 0 0.3"/><mass value="2"/></inertial></link>'
    + '<link name="three"/>'
    + joint("bolted", "world", "foot", 'xyz="5 5 5"', kind="fixed")
    + joint("a", "foot", "one", 'xyz="0 0 0.4"', "0 0 1")
    + joint("b", "one", "two", 'xyz="0.1 0 0" rpy="0 0 1.5707963267948966"', "1 0 0")
    + joint("glued", "two", "cap", 'xyz="0 0 0.1"', kind="fixed")
    + joint("c", "two", "three", 'xyz="0.5 0.02 0"', "0.6 0 0.8")
    + joint("end", "three", "flange", 'xyz="0.06 0 0.08"', kind="fixed")
    + "</robot>"
)


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    return path


def model(found):
    return RobotSpec.model_validate(yaml.safe_load(found.text)).model()


def test_an_orientation_of_urdf_that_nothing_has_is_named_with_its_joint(urdf):
    urdf.write_text(URDF.replace("1.5707963267948966", "1e20"))
    with pytest.raises(ConfigError, match=r"rpy of joint 'b' \(deg\) is 5\.\d+e\+21, where -3600 to 3600 deg is possible"):
        import_robot(urdf)


def test_urdf_limits_speeds_and_masses_of_all_that_moves_together(urdf):
    found = import_robot(urdf)
    arm = model(found)
    assert (found.base, found.flange, found.joints) == ("foot", "flange", ("a", "b", "c"))
    assert found.miss_mm < 1e-6
    assert arm.limits == pytest.approx(np.tile([-3, 2.5], (3, 1)), abs=1e-7)
    assert arm.speed == pytest.approx([2, 2, 2], abs=1e-7)
    assert arm.mass == pytest.approx([4, 4, 0])
    frames = arm.chain.frames(np.zeros((1, 3)))[0]
    # Link two and its cap: 0.1 m along x of two, which is y of the base, and 0.3 + 0.1 m above it; their mean in the base frame.
    assert se3.apply(frames[2], arm.com[1]) == pytest.approx([100, 50, 400 + 200], abs=2e-3)


def test_a_mass_below_zero_is_named_with_its_link(urdf):
    urdf.write_text(URDF.replace('<mass value="4"/>', '<mass value="-5"/>'))
    with pytest.raises(ConfigError, match="link 'one' has a mass of -5 kg; correct it"):
        import_robot(urdf)


def test_urdf_forward_kinematics_by_hand(urdf):
    """At a = 90 deg, all others at zero: the arm of 0.1 m points along y, the second link along -x."""
    arm = model(import_robot(urdf))
    T = arm.chain.flange(np.array([[np.pi / 2, 0, 0]]))[0]
    # In link two: (0.5 + 0.06, 0.02, 0.08) m, turned by 90 deg twice about z, then moved by (0, 0.1, 0.4).
    assert T[:3, 3] == pytest.approx([-560, 100 - 20, 480], abs=1e-6)


def test_gravity_of_an_imported_arm_is_that_of_its_weights(urdf):
    """Joint b turns about its link's x, which lies along y of the base: 4 kg whose centre lies 0.05 m along y exert nothing, but 0.2 m up."""
    arm = model(import_robot(urdf))
    q = np.array([[0.0, np.pi / 2, 0.0]])
    torque = gravity_torque(arm.chain, arm.chain.frames(q), arm.mass, arm.com, 0.0, np.zeros(3), arm.gravity)[0]
    assert abs(torque[1]) == pytest.approx(4 * 9.80665 * 0.2, rel=1e-4)


def test_xacro_is_expanded(tmp_path):
    pytest.importorskip("xacro")
    text = URDF.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1)
    text = text.replace('<link name="world"/>', '<xacro:property name="height" value="0.2"/><link name="world"/>').replace(
        'xyz="0 0 0.4"', 'xyz="0 0 ${2*height}"'
    )
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(text)
    (tmp_path / "arm.urdf").write_text(URDF)
    assert model(import_robot(path)).chain.rows == pytest.approx(model(import_robot(tmp_path / "arm.urdf")).chain.rows)


MJCF = """<mujoco><compiler angle="degree"/><worldbody><body name="foot" pos="1 0 0.1" euler="0 0 30">
<body name="one" pos="0 0 0.4"><inertial mass="4" pos="0 0 0.1" diaginertia="1 1 1"/><joint name="a" axis="0 0 1" range="-100 90" limited="true"/>
<body name="two" pos="0.1 0 0" euler="0 0 90"><inertial mass="2" pos="0.1 0 0" diaginertia="1 1 1"/><joint name="b" axis="1 0 0"/>
<body name="cap" pos="0 0 0.1"><inertial mass="2" pos="0 0 0.3" diaginertia="1 1 1"/></body>
<body name="three" pos="0.5 0.02 0"><inertial mass="0.001" pos="0 0 0" diaginertia="1e-6 1e-6 1e-6"/><joint name="c" axis="0.6 0 0.8"/>
<site name="flange" pos="0.06 0 0.08"/></body></body></body></body></worldbody></mujoco>"""


def test_mjcf_gives_the_same_arm_as_the_urdf(tmp_path, urdf):
    pytest.importorskip("mujoco")
    path = tmp_path / "arm.mjcf"
    path.write_text(MJCF)
    found, other = import_robot(path, base="foot", flange="flange", speed_deg_s=90), model(import_robot(urdf))
    arm, q = model(found), np.random.default_rng(1).uniform(-2, 2, (5, 3))
    assert arm.chain.flange(q)[:, :3, 3] == pytest.approx(other.chain.flange(q)[:, :3, 3], abs=1e-5)
    assert arm.mass[:2] == pytest.approx([4, 4])
    assert np.degrees(arm.limits[0]) == pytest.approx([-100, 90])
    assert np.degrees(arm.speed) == pytest.approx([90, 90, 90])


# Franka's own table (modified), and the rows of the shipped file (standard): one arm.
MODIFIED = [(0, 333, 0, 0), (0, 0, 0, -90), (0, 316, 0, 90), (0, 0, 82.5, 90), (0, 384, -82.5, -90), (0, 0, 0, 90), (0, 107, 88, 90)]


def test_a_modified_table_is_the_arm_of_the_standard_one(tmp_path):
    path = tmp_path / "panda.csv"
    path.write_text(
        "theta_deg;d_m;a_m;alpha_deg\n" + "".join(f"{t};{d / 1e3};{a / 1e3};{al}\n".replace(".", ",") for t, d, a, al in MODIFIED)
    )
    arm = model(import_robot(path, convention="modified"))
    known = RobotSpec.model_validate(yaml.safe_load(shipped.robot_file("panda").read_text())).model()
    assert arm.chain.rows == pytest.approx(known.chain.rows, abs=1e-9)


def test_no_number_is_written_that_yaml_takes_for_a_word(tmp_path):
    """A limit of 1e-05 deg, which YAML 1.1 reads as text for want of a dot."""
    rows = [[400.0, 0.0, 0.0, -90.0], [0.0, 25.0, 0.0, 0.0], [50.0, 455.0, 10.0, -90.0]]
    lines = ["d_mm,a_mm,theta_deg,alpha_deg,lower_deg,upper_deg", *(",".join(str(v) for v in [*row, -1e-5, 170.0]) for row in rows)]
    path = tmp_path / "rows.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    links = yaml.safe_load(import_robot(path, convention="standard").text)["links"]
    assert [link["limits_deg"] for link in links] == [[-1e-5, 170]] * 3


def test_a_standard_table_in_yaml(tmp_path):
    path = tmp_path / "ur.yaml"
    rows = [(0, 127.3, 0, 90), (0, 0, -612, 0), (0, 0, -572.3, 0), (0, 163.941, 0, 90), (0, 115.7, 0, -90), (0, 92.2, 0, 0)]
    path.write_text(yaml.safe_dump([dict(zip(("theta_deg", "d_mm", "a_mm", "alpha_deg"), row, strict=True)) for row in rows]))
    arm = model(import_robot(path, convention="standard"))
    known = RobotSpec.model_validate(yaml.safe_load(shipped.robot_file("ur10").read_text())).model()
    q = np.random.default_rng(0).uniform(-3, 3, (9, 6))
    assert arm.chain.flange(q) == pytest.approx(known.chain.flange(q), abs=1e-6)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("<robot ", "<machine "), "not well-formed"),
        (('link="three"/><origin xyz="0.5', 'link="three"/><origin xyz="${l}'), "is it a xacro file"),
        (('xyz="0 0 0.4"', 'xyz="0 0 nan"'), "should be 3 numbers"),
        (("'0.6 0 0.8'", "'0 0 0'"), "axis of length zero"),
        (('name="b" type="revolute"', 'name="b" type="planar"'), "joint 'b' is planar"),
    ],
)
def test_a_damaged_urdf_is_named(tmp_path, change, sentence):
    path = tmp_path / "arm.urdf"
    assert change[0] in URDF
    path.write_text(URDF.replace(*change))
    with pytest.raises(ConfigError, match=sentence):
        import_robot(path)


def test_links_that_do_not_exist_are_named_with_those_that_do(urdf):
    with pytest.raises(ConfigError, match="no link 'tool' for the flange; its links are world, foot, flange, one"):
        import_robot(urdf, flange="tool")
    with pytest.raises(ConfigError, match="no joints lead from link 'cap' to link 'flange'"):
        import_robot(urdf, base="cap")


def test_a_table_without_its_convention_is_asked_about(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("theta_deg,d_mm,a_mm,alpha_deg\n0,1,2,3\n0,1,2,x\n")
    with pytest.raises(ConfigError, match="say --convention standard or --convention modified"):
        import_robot(path)
    with pytest.raises(ConfigError, match="column alpha_deg: 'x' is not a number"):
        import_robot(path, convention="standard")


def test_the_command_writes_the_file_and_says_how_well_it_agrees(urdf, tmp_path):
    target = tmp_path / "made.yaml"
    done = CliRunner().invoke(app, ["robot", "import", str(urdf), "--out", str(target), "--json"], catch_exceptions=False)
    said = json.loads(done.stdout)
    assert said["joints"] == ["a", "b", "c"]
    assert said["miss_mm"] < 1e-6
    RobotSpec.model_validate(yaml.safe_load(target.read_text()))
