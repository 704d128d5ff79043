"""Parsers of robot descriptions: URDF, xacro, MJCF, a UR arm's factory calibration."""

from __future__ import annotations

from importlib.util import find_spec

from fuzz_target import Target, in_file

from mbcacq.model.robot_import import import_robot

_JOINT = (
    '<joint name="a{0}" type="revolute"><origin xyz="0.1 0 0.4" rpy="0 0.5 0"/><parent link="l{0}"/><child link="l{1}"/>'
    '<axis xyz="{2}"/><limit lower="-2.9" upper="2.9" effort="0" velocity="6"/></joint>\n<link name="l{1}"/>\n'
)
_ARM = '<link name="l0"/>\n' + "".join(_JOINT.format(i, i + 1, axis) for i, axis in enumerate(("0 0 1", "0 1 0", "0 1 0")))
URDF = f'<?xml version="1.0"?>\n<!-- drawn by hand -->\n<robot name="small">\n{_ARM}</robot>\n'.encode()
XACRO = f"""<?xml version="1.0"?>
<robot name="small" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="height" default="0.3"/>
<xacro:property name="h" value="${{2*0.1+sin(pi/2)+$(arg height)}}"/>
<xacro:macro name="tip" params="link *origin"><joint name="tip" type="fixed"><xacro:insert_block name="origin"/>
<parent link="${{link}}"/><child link="tool0"/></joint><link name="tool0"/></xacro:macro>
{_ARM}<xacro:if value="${{h > 0}}"><xacro:tip link="l3"><origin xyz="0 0 ${{h}}"/></xacro:tip></xacro:if>
</robot>
""".encode()
MJCF = b"""<mujoco><compiler angle="degree"/><worldbody><body name="foot" pos="1 0 0.1" euler="0 0 30">
<body name="upper" pos="0 0 0.4"><joint name="a1" axis="0 0 1" range="-170 170"/><inertial pos="0 0 0.1" mass="5" diaginertia="1 1 1"/>
<body name="fore" pos="0.1 0 0.5"><joint name="a2" axis="0 1 0"/><geom size="0.1"/>
<site name="flange" pos="0.06 0 0.08"/></body></body></body></worldbody></mujoco>"""
CALIBRATION = b"""kinematics:
  shoulder: {x: 0, y: 0, z: 0.18083, roll: 0, pitch: 0, yaw: 4.2e-05}
  upper_arm: {x: 0.00014, y: 0, z: 0, roll: 1.570441, pitch: 0, yaw: -1.1e-05}
  forearm: {x: -0.61288, y: 0, z: 0, roll: 3.141022, pitch: 3.140877, yaw: 3.141587}
  wrist_1: {x: -0.57144, y: -0.00036, z: 0.17415, roll: 0.002088, pitch: -0.001032, yaw: 1.2e-05}
  wrist_2: {x: 5.1e-05, y: -0.11981, z: -0.00026, roll: 1.572957, pitch: 0, yaw: 2.7e-06}
  wrist_3: {x: -3.4e-05, y: 0.11651, z: 0.00019, roll: 1.569156, pitch: 3.141593, yaw: -3.141592}
  hash: calib_1215668310164322373
"""


def description_targets() -> list[Target]:
    """All of them; xacro where it is installed."""
    out = [
        Target("robot URDF", (URDF,), in_file("arm.urdf", import_robot)),
        Target("robot MJCF", (MJCF,), in_file("arm.xml", import_robot)),
        Target("robot UR calibration", (CALIBRATION,), in_file("calibration.yaml", import_robot)),
    ]
    if find_spec("xacro"):
        out.append(Target("robot xacro", (XACRO,), in_file("arm.urdf.xacro", import_robot)))
    return out
