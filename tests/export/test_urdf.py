"""A patched URDF must move like the calibrated arm."""

import codecs
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.exports import urdf
from mbcacq.geometry.chain import Chain

# a small arm of the KUKA kind, base to flange, with the senses of a KUKA controller
CHAIN = Chain(
    np.array([-1, 1, 1, -1, 1, -1.0]),
    np.radians([0, 0, -90, 0, 0, 180]),
    np.array([400, 0, 0, 420, 0, 80.0]),
    np.array([25, 455, 35, 0, 0, 0.0]),
    np.radians([-90, 0, -90, 90, -90, 180]),
    np.zeros(6),
)
ERRORS = np.random.default_rng(4).normal(size=(6, 5)) * [3e-4, 0.2, 0.2, 2e-4, 2e-4]
ERRORS[-1] = 0

# joint frames parallel to the base at zero, as robot makers draw them; lengths in metres
URDF = """<?xml version="1.0" ?>
<!-- drawn by hand -->
<robot name="small">
  <link name="world"/>
  <joint name="stand" type="fixed"><parent link="world"/><child link="base_link"/><origin xyz="1 2 0.5" rpy="0 0 0.3"/></joint>
  <link name="base_link"/>
  <joint name="a1" type="revolute">
    <!-- the big one -->
    <origin xyz="0 0 0.4" rpy="0 0 0"/>
    <parent link="base_link"/><child link="l1"/><axis xyz="0 0 -1"/>
    <limit lower="-2.96" upper="2.96" effort="0" velocity="6"/>
  </joint>
  <link name="l1"/>
  <joint name="a2" type="revolute">
    <origin xyz="0.025 0 0" rpy="0 0 0"/><parent link="l1"/><child link="l2"/><axis xyz="0 1 0"/>
  </joint>
  <link name="l2"/>
  <joint name="a3" type="revolute">
    <origin xyz="0.455 0 0"/><parent link="l2"/><child link="l3"/><axis xyz="0 1 0"/>
  </joint>
  <link name="l3"/>
  <joint name="a4" type="revolute">
    <origin xyz="0.2 0 0.035" rpy="0 ${pi/2} 0"/><parent link="l3"/><child link="l4"/><axis xyz="0 0 -1"/>
  </joint>
  <link name="l4"/>
  <joint name="a5" type="revolute">
    <origin xyz="0 0 0.22" rpy="0 ${-pi/2} 0"/><parent link="l4"/><child link="l5"/><axis xyz="0 1 0"/>
  </joint>
  <link name="l5"/>
  <joint name="a6" type="revolute">
    <origin xyz="0.08 0 0"/><parent link="l5"/><child link="l6"/><axis xyz="-1 0 0"/>
  </joint>
  <link name="l6"/>
  <joint name="flange" type="fixed"><origin rpy="0 1.5707963267948966 0"/><parent link="l6"/><child link="tool0"/></joint>
  <link name="tool0"/>
</robot>
"""


def rot(axis, angle):
    k = np.asarray(axis, float)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def follow(text: bytes, q, last="flange"):
    """Forward kinematics of a URDF from base_link, in mm, written down from the URDF's definition."""
    T, number = np.eye(4), 0
    for joint in ElementTree.fromstring(text).iter("joint"):
        if joint.get("name") == "stand":
            continue
        origin = joint.find("origin")
        xyz = [float(v) for v in origin.get("xyz", "0 0 0").split()]
        r, p, y = [float(eval(v[2:-1], {"pi": np.pi}) if v.startswith("$") else v) for v in origin.get("rpy", "0 0 0").split()]
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = rot([0, 0, 1], y) @ rot([0, 1, 0], p) @ rot([1, 0, 0], r), 1e3 * np.array(xyz)
        T = T @ step
        if joint.get("type") == "revolute":
            turn = np.eye(4)
            turn[:3, :3] = rot([float(v) for v in joint.find("axis").get("xyz").split()], q[number])
            T, number = T @ turn, number + 1
        if joint.get("name") == last:
            return T
    raise AssertionError(last)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    return path


def test_the_drawn_arm_is_the_nominal_one():
    q = np.random.default_rng(0).uniform(-2, 2, 6)
    difference = np.linalg.inv(follow(URDF.encode(), q)) @ CHAIN.flange(q[None])[0]
    zero = np.linalg.inv(follow(URDF.encode(), np.zeros(6))) @ CHAIN.flange(np.zeros((1, 6)))[0]
    np.testing.assert_allclose(difference, zero, atol=1e-9)


def test_the_patched_arm_moves_like_the_calibrated_one(file):
    calibrated = CHAIN.with_errors(ERRORS)
    patched = urdf.patch(file, CHAIN, calibrated)
    tool = np.linalg.inv(follow(URDF.encode(), np.zeros(6))) @ CHAIN.flange(np.zeros((1, 6)))[0]
    for q in np.random.default_rng(1).uniform(-2.5, 2.5, (20, 6)):
        np.testing.assert_allclose(follow(patched, q) @ tool, calibrated.flange(q[None])[0], atol=2e-5)


def test_nothing_to_correct_leaves_every_line_as_it_was(file):
    assert urdf.patch(file, CHAIN, CHAIN) == URDF.encode()


def test_line_ends_of_windows_stay(file):
    file.write_bytes(URDF.replace("\n", "\r\n").encode())
    assert urdf.patch(file, CHAIN, CHAIN) == file.read_bytes()


def test_every_byte_but_that_of_the_origins_stays(file):
    """Quotes, name spaces, character data and attributes' order are those of the file, in its encoding."""
    text = URDF.replace('<?xml version="1.0" ?>', "<?xml version='1.0' encoding='iso-8859-1'?>")
    text = text.replace(
        '<robot name="small">', "<robot xmlns:xacro='http://www.ros.org/wiki/xacro'  name='klein — größer'>".replace("—", "-")
    )
    text = text.replace('<link name="l6"/>', "<xacro:macro name='m'><![CDATA[a < b & c]]></xacro:macro><!-- ü --><link name='l6' />")
    file.write_bytes(text.encode("iso-8859-1"))
    patched = urdf.patch(file, CHAIN, CHAIN.with_errors(ERRORS)).decode("iso-8859-1")
    origin = re.compile("<origin[^>]*>")
    assert [origin.sub("", line) for line in patched.splitlines()] == [origin.sub("", line) for line in text.splitlines()]
    assert patched != text


def test_a_joint_without_origin_gets_one_and_utf_16_stays(file):
    text = URDF.replace('<origin xyz="0.455 0 0"/><parent link="l2"/>', '<parent link="l2"/>').replace('<?xml version="1.0" ?>\n', "")
    moved = Chain(CHAIN.sign, CHAIN.theta, CHAIN.d, CHAIN.a - [0, 455, 0, 0, 0, 0], CHAIN.alpha, CHAIN.beta)
    longer = Chain(CHAIN.sign, CHAIN.theta, CHAIN.d, CHAIN.a - [0, 450, 0, 0, 0, 0], CHAIN.alpha, CHAIN.beta)
    file.write_bytes(codecs.BOM_UTF16_BE + text.encode("utf-16-be"))
    patched = urdf.patch(file, moved, longer)
    assert patched[:2] == codecs.BOM_UTF16_BE
    assert '<axis xyz="0 1 0"/>\n  <origin xyz="0.005 0 0" rpy="0 0 0"/></joint>' in patched[2:].decode("utf-16-be")


def test_comments_limits_and_other_joints_stay(file):
    patched = urdf.patch(file, CHAIN, CHAIN.with_errors(ERRORS)).decode()
    for kept in (
        "<!-- drawn by hand -->",
        "<!-- the big one -->",
        'xyz="1 2 0.5" rpy="0 0 0.3"',
        '<limit lower="-2.96" upper="2.96" effort="0" velocity="6"/>',
    ):
        assert kept in patched
    before, after = URDF.splitlines(), patched.splitlines()
    assert len(before) == len(after)
    assert all("origin" in b for b, a in zip(before, after, strict=True) if a != b)


def test_the_scanner_is_added_once_and_then_updated(file, tmp_path):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rot([1, 0, 0], np.pi), [1, 2, 265]
    once = urdf.patch(file, CHAIN, CHAIN, T_flange_scanner=T, scanner="camera")
    T[2, 3] = 266.0
    (tmp_path / "b.urdf").write_bytes(once)
    twice = urdf.patch(tmp_path / "b.urdf", CHAIN, CHAIN, T_flange_scanner=T, scanner="camera")
    joints = [j for j in ElementTree.fromstring(twice).iter("joint") if j.find("child").get("link") == "camera"]
    assert len(joints) == 1
    assert joints[0].find("parent").get("link") == "tool0"
    # tool0 of this file looks out of the arm, the flange of the MD-H chain into it: half a turn about x lies between them.
    assert [float(v) for v in joints[0].find("origin").get("xyz").split()] == [0.001, -0.002, -0.266]
    assert [float(v) for v in joints[0].find("origin").get("rpy").split()] == [0, 0, 0]


def test_another_robot_is_refused(file):
    longer = Chain(CHAIN.sign, CHAIN.theta, CHAIN.d, CHAIN.a + [0, 100, 0, 0, 0, 0], CHAIN.alpha, CHAIN.beta)
    with pytest.raises(ConfigError, match=r"arm\.urdf:\d+: the axis of joint 'a3' is 100.0 mm"):
        urdf.patch(file, longer, longer)
    other_sense = Chain(-CHAIN.sign, CHAIN.theta, CHAIN.d, CHAIN.a, CHAIN.alpha, CHAIN.beta)
    with pytest.raises(ConfigError, match="180.0°"):
        urdf.patch(file, other_sense, other_sense)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name="a6" type="revolute"', 'name="a6" type="fixed"', "5 moving joints"),
        ("0 ${pi/2} 0", "${tilt} 0 0", "expand the file with xacro"),
        ('<axis xyz="-1 0 0"/>', '<axis xyz="-1 0"/>', "the axis of joint 'a6' is not three numbers"),
        ("</robot>", "", "not well-formed"),
        ("<robot", '<!DOCTYPE r [<!ENTITY a "b">]><robot', "entities"),
        ("</robot>", "<a>" * 300 + "</a>" * 300 + "</robot>", "nested more than 200 deep"),
        ('version="1.0" ?', 'version="1.0" encoding="utf-99"?', "unknown encoding"),
    ],
)
def test_a_file_that_cannot_be_used_is_named(tmp_path, old, new, message):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.replace(old, new))
    with pytest.raises(ConfigError, match=message):
        urdf.patch(path, CHAIN, CHAIN)
