"""Robot descriptions in the forms that makers, exporters and simulators write them: read as they are meant, or refused by the right name."""

import json

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.robot_import import import_robot

LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="2"/>'


def joint(name, parent, child, kind="revolute", axis="0 1 0", xyz="0 0 0.2", more=LIMIT):
    place = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/><axis xyz="{axis}"/>'
    return f'<joint name="{name}" type="{kind}">{place}{"" if kind == "fixed" else more}</joint>'


def described(joints, links=None, shapes=()):
    """A URDF of some joints, whose links are those that they name."""
    named = links or list(dict.fromkeys(part.split('"')[0] for j in joints for part in j.split('link="')[1:]))
    body = '<visual><geometry><sphere radius="1"/></geometry></visual>'
    return (
        '<robot name="demo">'
        + "".join(f'<link name="{n}">{body if n in shapes else ""}</link>' for n in named)
        + "".join(joints)
        + "</robot>"
    )


def arm(axes, prefix=""):
    """Joints of an arm of so many axes, from link0 on."""
    turning = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 1 0")
    return [joint(f"{prefix}joint{i + 1}", f"{prefix}link{i}", f"{prefix}link{i + 1}", axis=turning[i]) for i in range(axes)]


@pytest.fixture
def read(tmp_path):
    def read(text, name="arm.urdf", **options):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return import_robot(path, **options)

    return read


def test_the_axis_of_a_fixed_joint_means_nothing_that_of_a_revolute_one_does(read):
    found = read(described([*arm(3), joint("mount", "link3", "flange", "fixed", axis="0 0 0")]))
    assert (found.flange, len(found.joints)) == ("flange", 3)
    with pytest.raises(ConfigError, match="joint 'joint1' has an axis of length zero"):
        read(described([*arm(3)]).replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>'))


GRIPPERS = {
    "a jaw by name": ["gripper_joint|link5|jaw"],
    "the joint of SO-100": ["gripper|link5|jaw"],
    "Interbotix: a turning propeller and two slides": [
        "gripper|link5|prop",
        "left_finger|link5|lf|prismatic",
        "right_finger|link5|rf|prismatic",
    ],
    "two slides without a name": ["j8|link5|a|prismatic", "j9|link5|b|prismatic"],
    "one slide behind five axes": ["j8|link5|a|prismatic"],
    "Spot": ["arm_f1x|link5|arm_link_fngr"],
    "Z1": ["jointGripper|link5|gripperMover"],
    "a hand of three fingers with two joints": ["t1|link5|t1", "t2|t1|t2", "i1|link5|i1", "i2|i1|i2", "m1|link5|m1", "m2|m1|m2"],
    "knuckles behind a fixed palm": [
        "palm|link5|palm|fixed",
        "robotiq_85_left_knuckle_joint|palm|lk",
        "robotiq_85_right_knuckle_joint|palm|rk",
    ],
}


@pytest.mark.parametrize("joints", GRIPPERS.values(), ids=GRIPPERS)
def test_a_gripper_is_no_axis_of_the_arm_and_a_note_says_so(read, joints):
    found = read(described([*arm(5), *(joint(*j.split("|")) for j in joints)], shapes=("palm",)))
    assert found.joints == ("joint1", "joint2", "joint3", "joint4", "joint5")
    assert found.flange in ("link5", "palm")
    assert any("taken for a gripper's and left out" in remark for remark in found.remarks)


def test_the_wrist_that_turns_a_gripper_is_an_axis(read):
    joints = [*arm(4), joint("gripper_roll", "link4", "gripper"), joint("gripper", "gripper", "moving_part")]
    assert read(described(joints)).joints[-1] == "gripper_roll"


OPENING = '<limit lower="-0.1" upper="1.7" effort="1" velocity="2"/>'


def test_a_last_joint_that_opens_as_jaws_and_moves_what_is_called_a_gripper_is_none_of_the_arm(read):
    frames = [joint("f1", "link4", "tcp", "fixed"), joint("f2", "link5", "gripper_tip", "fixed")]
    found = read(described([*arm(4), joint("joint5", "link4", "link5", more=OPENING), *frames]))
    assert found.joints == ("joint1", "joint2", "joint3", "joint4")
    assert any("taken for a gripper's and left out" in remark for remark in found.remarks)
    assert len(read(described([*arm(4), joint("joint5", "link4", "link5"), *frames])).joints) == 5  # it turns to both sides


def test_a_last_joint_that_opens_to_one_side_is_said(read):
    found = read(described([*arm(4), joint("joint5", "link4", "link5", more=OPENING)]))
    assert len(found.joints) == 5
    assert any("opens to one side only" in remark and "--flange link4" in remark for remark in found.remarks)


def test_the_flange_is_what_is_fixed_behind_the_last_link(read):
    hand = [joint("joint8", "link7", "link8", "fixed"), joint("hand", "link8", "hand", "fixed"), joint("f1", "hand", "finger1")]
    assert read(described([*arm(7), *hand], shapes=("link7", "link8", "hand"))).flange == "link8"
    bare = [*arm(6), joint("end", "link6", "tip", "fixed")]
    assert read(described(bare, shapes=("link6",))).flange == "tip"
    assert read(described(bare, shapes=("link6", "tip"))).flange == "link6"
    camera = [*arm(6), joint("end", "link6", "tool0", "fixed"), joint("camera", "link6", "camera", "fixed")]
    assert read(described(camera)).flange == "tool0"


def test_one_arm_on_a_lift_with_a_head_is_found(read):
    others = [joint(f"wheel{i}", "base", f"wheel{i}", "continuous") for i in range(4)] + [
        joint("lift", "base", "torso", "prismatic"),
        joint("pan", "torso", "pan"),
        joint("tilt", "pan", "head"),
        joint("mount", "torso", "link0", "fixed"),
    ]
    found = read(described([*others, *arm(6)]))
    assert (found.base, found.flange, found.joints[0]) == ("base", "link6", "lift")
    assert any("the longest, of 6 axes, is taken" in remark for remark in found.remarks)


def test_a_slide_without_ends_is_a_vehicles(read):
    """A vehicle that slides without limits, then turns, with an arm of seven axes: eight are left behind the slide."""
    vehicle = [joint("slide", "world", "on_x", "prismatic", more=""), joint("turn", "on_x", "link0", "continuous")]
    found = read(described([*vehicle, *arm(7)]))
    assert found.joints[0] == "turn"
    assert any("'turn' behind what carries the arm counts as axis 1" in remark and "--base link0" in remark for remark in found.remarks)
    without = read(described([*vehicle, *arm(7)]), base="link0")
    assert len(without.joints) == 7
    both = [*vehicle[:1], joint("turn", "on_x", "base", "continuous"), joint("up", "base", "link0", "prismatic", more="")]
    assert any(remark.startswith("slide, turn, up carry the arm") for remark in read(described([*both, *arm(6)])).remarks)
    with pytest.raises(ConfigError, match="'up' is prismatic without limits"):
        read(described([joint("one", "world", "l1"), joint("two", "l1", "base"), *both[2:], *arm(3)]))


def model_of(found):
    return RobotSpec.model_validate(yaml.safe_load(found.text)).model()


def test_an_arm_on_a_track_has_the_track_as_its_first_axis(read):
    """The track along x, 3 m long: the flange moves by what the track moves, in mm."""
    found = read(
        described([joint("track", "world", "link0", "prismatic", "1 0 0", more=LIMIT.replace("-2", "0").replace('"2"', '"3"', 1)), *arm(6)])
    )
    robot = model_of(found)
    assert robot.axes == ("E1", "A1", "A2", "A3", "A4", "A5", "A6")
    assert robot.limits[0].tolist() == [0.0, 3000.0]
    assert robot.speed[0] == 2000.0
    q = np.zeros((2, 7))
    q[1, 0] = 1234.5
    at = robot.chain.flange(q)
    np.testing.assert_allclose(at[1] - at[0], np.outer([1234.5, 0, 0, 0], [0, 0, 0, 1.0]), atol=1e-9)


def test_a_slide_between_turning_axes_is_one_of_them(read):
    """The arm of Stanford: two turns, a slide, three turns; forwards as each joint by itself."""
    slide = joint("slide", "link2", "carriage", "prismatic", "0 1 0")
    behind = [
        joint(f"wrist{i}", before, f"hand{i}", axis=a)
        for i, before, a in ((1, "carriage", "0 0 1"), (2, "hand1", "1 0 0"), (3, "hand2", "0 0 1"))
    ]
    robot = model_of(read(described([*arm(2), slide, *behind])))
    assert robot.chain.sliding == (2,)
    q = np.array([[0.0, np.pi / 2, 500.0, 0, 0, 0]])  # axis 2 turns the slide's y about itself: it moves along y
    zero = robot.chain.flange(q * [1, 1, 0, 1, 1, 1])[0, :3, 3]
    np.testing.assert_allclose(robot.chain.flange(q)[0, :3, 3] - zero, [0, 500, 0], atol=1e-9)


def test_a_joint_that_copies_another_moves_with_it(read):
    """A parallelogram: 'level' turns back what 'joint2' turns, and keeps what follows upright at every angle."""
    level = joint("level", "link2", "wrist", more=f'{LIMIT}<mimic joint="joint2" multiplier="-1" offset="0.25"/>')
    robot = model_of(read(described([*arm(2), level, joint("turn", "wrist", "flange", axis="0 0 1")])))
    q = np.zeros((3, 4))
    q[:, 1] = [-1.0, 0.3, 1.2]
    at = robot.chain.flange(q)
    c, s = np.cos(0.25), np.sin(0.25)
    np.testing.assert_allclose(at[:, :3, :3], np.tile([[c, 0, s], [0, 1, 0], [-s, 0, c]], (3, 1, 1)), atol=1e-12)
    assert robot.limits[2].tolist() == [0, 0]
    twists = robot.chain.joint_twists(robot.chain.frames(q))
    np.testing.assert_allclose(twists[:, 1, 3:], 0, atol=1e-12)


def test_of_two_arms_none_is_taken_without_being_asked(read):
    both = described(
        [*arm(6, "left_"), *arm(6, "right_"), joint("l", "base", "left_link0", "fixed"), joint("r", "base", "right_link0", "fixed")]
    )
    with pytest.raises(ConfigError, match="2 chains of joints end in left_link6, right_link6; name the arm's flange with --flange"):
        read(both)
    assert read(both, flange="right_link6").joints[0] == "right_joint1"


def test_joints_that_follow_what_is_elsewhere_are_no_axes(read):
    """A wrist joint that copies one outside of the arm, and the side rod of a parallelogram."""
    level = joint("level", "link3", "wrist", more=f'{LIMIT}<mimic joint="elsewhere"/>')
    with pytest.raises(ConfigError, match="joint 'level' follows 'elsewhere', which is no axis between base and flange"):
        read(described([*arm(3), level, joint("turn", "wrist", "end")]))
    rod = joint("rod", "link1", "rod", more=f'{LIMIT}<mimic joint="joint2"/>')
    assert read(described([*arm(6), rod])).flange == "link6"


def test_limits_that_cannot_be_meant_are_said(read):
    limits = ['lower="0" upper="0"', 'lower="2" upper="-1"', 'lower="-170" upper="170"', 'lower="-1e16" upper="1e16"']
    joints = [joint(f"j{i}", f"l{i}", f"l{i + 1}", more=f'<limit {lim} effort="1" velocity="2"/>') for i, lim in enumerate(limits)]
    found = read(described(joints))
    links = yaml.safe_load(found.text)["links"]
    assert ["limits_deg" in link for link in links] == [False, True, False, True]
    assert links[1]["limits_deg"] == pytest.approx(np.degrees([-1, 2]).tolist(), abs=1e-5)
    assert links[3]["limits_deg"] == [-360, 360]
    for sentence in ("'j0' has limits 0 0", "'j1' has limits 2 -1, the larger first", "'j2' has limits -170 170, which look like degrees"):
        assert any(remark.startswith(sentence) for remark in found.remarks)


def test_speeds_and_lengths_in_other_units_are_not_taken(read):
    fast = described(arm(4)).replace('velocity="2"', 'velocity="180"')
    found = read(fast)
    assert "speed_deg_s" not in found.text
    assert any("180 rad/s, more than any axis turns" in remark for remark in found.remarks)
    with pytest.raises(ConfigError, match="looks like mm; a URDF has lengths in m"):
        read(described([joint(f"j{i}", f"l{i}", f"l{i + 1}", xyz="0 300 50000") for i in range(3)]))


def test_what_is_no_tree_is_named(read):
    with pytest.raises(ConfigError, match="link 'link2' hangs on two joints, 'joint2' and 'rod'"):
        read(described([*arm(3), joint("rod", "link0", "link2")]))
    with pytest.raises(ConfigError, match="two joints are called 'joint1'"):
        read(described([*arm(3), joint("joint1", "link3", "link4")]))
    apart = read(described([*arm(3), joint("mount", "camera_mount", "camera", "fixed")]))
    assert any("nothing connects the arm" in remark and "'camera_mount'" in remark for remark in apart.remarks)


@pytest.mark.parametrize(
    "text",
    [
        "\n \n" + '<?xml version="1.0"?>\n' + described(arm(3)),
        described(arm(3)).replace("<robot ", '<robot xmlns="http://www.ros.org" ', 1),
        "<!DOCTYPE robot>\n" + described(arm(3)),
        '<!DOCTYPE robot SYSTEM "robot.dtd">\n' + described(arm(3)),
        described(arm(3)).replace("<limit ", '<limit drake:acceleration="2" '),
        described(arm(3)).replace("</robot>", "<sim:camera><sim:x/></sim:camera><mujoco/></robot>"),
    ],
    ids=["blank lines", "default namespace", "document type", "external document type", "prefix of an attribute", "prefix of an element"],
)
def test_xml_that_others_read_is_read(read, text):
    assert read(text).joints == ("joint1", "joint2", "joint3")


def test_xml_of_other_kinds_is_named(read):
    for text, sentence in (
        ("<sdf version='1.6'/>", "begins with <sdf>, not with <robot>"),
        ("<mujocoinclude/>", "is a part of an MJCF file"),
        ("<robot name='a'><macro name='b'/></robot>", "has <macro> without 'xacro:'"),
        ("<robot name='a'><link name='b'/></robot>", "has no moving joints"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            read(text, "a.xml")


MACRO = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="demo_arm" params="height">{}</xacro:macro></robot>'
CALL = (
    '<robot name="demo" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="height" default="0.3"/>'
    '<xacro:include filename="$(find {})/urdf/macro.xacro"/><xacro:demo_arm height="$(arg height)"/></robot>'
)


@pytest.fixture
def packages(tmp_path):
    """Two packages of a repository; the arm of the one calls a macro of the other."""
    pytest.importorskip("xacro")
    macro = described(arm(3)).replace('xyz="0 0 0.2"', 'xyz="0 0 ${height}"', 1)
    for name in ("demo_description", "demo_support"):
        (tmp_path / "src" / name / "urdf").mkdir(parents=True)
        (tmp_path / "src" / name / "package.xml").write_text(f'<package format="2"><name>{name}</name></package>')
    (tmp_path / "src/demo_support/urdf/macro.xacro").write_text(MACRO.format(macro[macro.index(">") + 1 : -len("</robot>")]))
    (tmp_path / "src/demo_description/urdf/arm.urdf.xacro").write_text(CALL.format("demo_support"))
    (tmp_path / "src/demo_support/urdf/own.xacro").write_text(CALL.format("demo_support"))
    return tmp_path / "src"


def test_xacro_finds_its_packages_above_and_beside_the_file_without_ros(packages):
    for name in ("demo_support/urdf/own.xacro", "demo_description/urdf/arm.urdf.xacro"):
        found = import_robot(packages / name)
        assert found.joints == ("joint1", "joint2", "joint3")
        assert found.T_given_base[2, 3] == pytest.approx(0)
        assert model_of(found).chain.flange(np.zeros((1, 3)))[0, 2, 3] == pytest.approx(700)


def test_xacro_takes_arguments_and_folders_of_packages(packages, tmp_path):
    alone = tmp_path / "alone.xacro"
    alone.write_text(CALL.format("demo_support").replace('<xacro:arg name="height" default="0.3"/>', ""))
    with pytest.raises(ConfigError, match="package 'demo_support' is not found above the file or beside it; say where by --package"):
        import_robot(alone)
    folder = {"demo_support": packages / "demo_support"}
    with pytest.raises(ConfigError, match="needs an argument 'height'; give it by --arg height=VALUE"):
        import_robot(alone, packages=folder)
    out = tmp_path / "made.yaml"
    words = f"robot import {alone} --package demo_support={packages / 'demo_support'} --arg height=0.5 --out {out} --json".split()
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    assert json.loads(done.stdout)["joints"] == ["joint1", "joint2", "joint3"]
    assert yaml.safe_load(out.read_text())["links"][0]["d_mm"] + yaml.safe_load(out.read_text())["links"][1]["d_mm"] == pytest.approx(700)


def test_a_file_of_macros_says_so(packages):
    with pytest.raises(ConfigError, match=r"defines macros only \(demo_arm\); import the file that calls them"):
        import_robot(packages / "demo_support/urdf/macro.xacro")


MESHED = """<mujoco><asset><mesh name="m" file="none.stl"/></asset><worldbody><body name="base"><geom type="mesh" mesh="m"/>
<body name="l1" pos="0 0 .3"><inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/><joint name="j1" axis="0 0 1" range="-90 90"/>
<geom type="mesh" mesh="m" name="shape"/><body name="l2" pos="0.1 0 .2"><joint name="j2" axis="0 1 0"/><geom type="mesh" mesh="m"/>
</body></body></body></worldbody><sensor><user dim="1"/></sensor><contact><exclude body1="l1" body2="l2"/></contact></mujoco>"""


def test_mjcf_is_read_without_its_meshes(read):
    found = read(MESHED, "arm.xml")
    assert found.joints == ("j1", "j2")
    assert any("none.stl" in remark and "masses of base, l2 are unknown" in remark for remark in found.remarks)
    robot = model_of(found)
    assert robot.mass.tolist() == [3, 0]
    T = found.T_given_base @ robot.chain.flange(np.array([[np.pi / 2, 0]]))[0] @ found.T_flange_given
    assert T[:3, 3] == pytest.approx([0, 100, 500], abs=1e-6)


def mjcf(inside, more=""):
    """An arm of five hinges with something on its last body."""
    text = inside
    for number in range(5, 0, -1):
        text = f'<body name="b{number}" pos="0.1 0 0.2"><joint name="j{number}" axis="0 {number % 2} {1 - number % 2}"/><geom size="0.1"/>{text}</body>'
    return f'<mujoco><worldbody><body name="b0">{text}</body></worldbody>{more}</mujoco>'


FINGERS = "".join(
    f'<body name="{n}"><joint name="{n}_slide" type="slide" axis="0 1 0"/><geom size="0.01"/></body>' for n in ("left", "right")
)


HAND = '<body name="hand" pos="0 0 .1"><geom {shape}/></body>'
DRIVEN = (
    '<tendon><fixed name="both"><joint joint="left_slide" coef=".5"/><joint joint="right_slide" coef=".5"/></fixed></tendon>'
    '<actuator><position name="a1" joint="j1"/><general name="grip" tendon="both"/></actuator>'
    '<keyframe><key name="home" qpos="0 0 0 0 0 0 0" ctrl="0 255"/></keyframe>'
)


def test_mjcf_without_its_meshes_has_the_flange_that_it_has_with_them(read):
    """Without shapes an actuator of a tendon goes, whose numbers the keyframes hold; and a hand has a shape though its mesh is missing."""
    meshed = DRIVEN + '<asset><mesh name="m" file="none.stl"/></asset>'
    hand = HAND.format(shape='type="mesh" mesh="m"').replace("</body>", FINGERS + "</body>")
    without, with_shapes = (
        read(text, "arm.xml")
        for text in (mjcf(hand, meshed), mjcf(HAND.format(shape='size=".01"').replace("</body>", FINGERS + "</body>"), DRIVEN))
    )
    assert without.flange == with_shapes.flange == "b5"
    assert without.joints == with_shapes.joints
    assert any("none.stl" in remark for remark in without.remarks)


@pytest.mark.parametrize("limits", ["-170 inf", "-inf 170", "-170 nan", "-170 -inf", "170 -170"])
def test_limits_of_mjcf_that_are_none_are_named_with_their_joint(read, limits):
    text = mjcf("").replace('name="j2"', f'name="j2" range="{limits}"')
    with pytest.raises(ConfigError, match="'j2' has the limits"):
        read(text, "arm.xml")


@pytest.mark.parametrize("mass", ["-5", "nan", "-inf"])
def test_a_mass_of_mjcf_that_no_body_has_is_named_with_its_body(read, mass):
    text = mjcf("").replace('<joint name="j2"', f'<inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/><joint name="j2"')
    with pytest.raises(ConfigError, match=f"body 'b2' has a mass of {mass} kg"):
        read(text, "arm.xml")


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ('<body name="x" euler="1e20 0 0"/>', r"orientation \(deg\) of body 'x' is 1e\+20, where -3600 to 3600 deg is possible"),
        ('<body name="x" axisangle="0 0 1 1e20"/>', r"orientation \(deg\) of body 'x'"),
        ('<site name="x" quat="1e20 0 0 0"/>', "orientation of site 'x'"),
        ('<frame name="x" zaxis="1e20 0 1"/>', "orientation of frame 'x'"),
        ('<geom name="x" size="1e20"/>', r"size \(mm\) of geom 'x' is 1e\+23"),
        ('<site name="x" size="1e20"/>', r"size \(mm\) of site 'x'"),
    ],
)
def test_an_orientation_or_size_that_nothing_has_is_named_with_its_element(read, part, said):
    with pytest.raises(ConfigError, match=said):
        read(mjcf(part), "arm.xml")


def test_mjcf_knows_grippers_sites_and_several_arms_as_urdf_does(read):
    found = read(mjcf(FINGERS), "arm.xml")
    assert (len(found.joints), found.flange) == (5, "b5")
    assert any("left_slide, right_slide behind it taken for a gripper's" in remark for remark in found.remarks)
    assert read(mjcf(FINGERS + '<site name="attachment_site" pos="0 0 0.1"/>'), "arm.xml").flange == "attachment_site"
    two = mjcf("").replace(
        "</worldbody>",
        '<body name="c0">'
        + mjcf("").split('<body name="b0">')[1].split("</body></worldbody>")[0].replace('"b', '"c').replace('"j', '"k')
        + "</body></worldbody>",
    )
    with pytest.raises(ConfigError, match="2 chains of joints end in b5, c5"):
        read(two, "two.xml")


def test_mjcf_joints_that_follow_others_move_with_them(read):
    found = model_of(read(mjcf("", '<equality><joint joint1="j4" joint2="j2" polycoef="0 0.5 0 0 0"/></equality>'), "arm.xml"))
    assert found.chain.follows == ((3, 1, 0.5),)
    free = model_of(read(mjcf(""), "free.xml"))
    q = np.array([[0.1, 0.4, -0.3, 0.0, 0.2]])
    np.testing.assert_allclose(found.chain.flange(q), free.chain.flange(q + [[0, 0, 0, 0.2, 0]]), atol=1e-9)
