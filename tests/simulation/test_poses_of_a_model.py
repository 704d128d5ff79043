"""Poses of an arm against a MuJoCo model of it: the geometry comes back in the model's own bodies and joints."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mbcacq.calibration.calibrate import calibrate
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, Station
from mbcacq.model.observations import Observations

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is in the extra mjcf")

NOISE_MM = 0.01
ARM = """<mujoco><compiler angle="degree"/><worldbody><body name="foot" pos="1 0 0.1" euler="0 0 30">
<body name="link1" pos="0 0 0.2"><joint name="A1" axis="0 0 1" range="-170 170" ref="10"/>{m}
<body name="link2" pos="0.15 0 0.2"><joint name="A2" axis="0 1 0" range="-120 60"/>{m}
<body name="link3" pos="0 0 0.6" euler="0 5 0"><joint name="A3" axis="0 1 0" pos="0 0.02 0" range="-120 120"/>{m}
<body name="link4" pos="0.2 0 0.1"><joint name="A4" axis="1 0 0" range="-180 180"/>{m}
<body name="link5" pos="0.45 0 0"><joint name="A5" axis="0 1 0" range="-110 110"/>{m}
<body name="link6" pos="0.1 0 0"><joint name="A6" axis="1 0 0" range="-350 350"/>{m}
</body></body></body></body></body></body></body></worldbody></mujoco>""".replace(
    "{m}", '<inertial pos="0.1 0 0" mass="5" diaginertia="0.1 0.1 0.1"/>'
)
OTHER = (  # what the real arm is like
    ARM.replace('pos="0.15 0 0.2"', 'pos="0.1508 0.0003 0.1996"')
    .replace('pos="0.45 0 0"', 'pos="0.4493 0.0004 0.0002"')
    .replace('name="A3" axis="0 1 0"', 'name="A3" axis="0.0008 1 0.0005"')
    .replace('euler="0 5 0"', 'euler="0 5.04 0"')
)
ROTORS = re.sub(r'(axis="[^"]*") (ref|pos|range)', r'\1 armature="2" \2', ARM)
REFLECTOR_M = np.array([0.08, 0.05, 0.03])


def places(text, q):
    """(P, 3) mm of the reflector on link 6 in the world, by MuJoCo."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    address = [model.joint(f"A{k}").qposadr[0] for k in range(1, 7)]
    body, out = model.body("link6").id, []
    for row in q:
        data.qpos[address] = row
        mujoco.mj_kinematics(model, data)
        out.append(1e3 * (data.xpos[body] + data.xmat[body].reshape(3, 3) @ REFLECTOR_M))
    return np.array(out)


def random_angles(n, seed):
    return np.radians(np.random.default_rng(seed).uniform([-150, -110, -100, -170, -100, -200], [150, 40, 100, 170, 100, 200], (n, 6)))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    from mbcacq.simulation.mujoco_arm import load_arm

    path = tmp_path_factory.mktemp("model") / "arm.xml"
    path.write_text(ARM)
    return load_arm(path)


@pytest.fixture(scope="module")
def recorded(arm):
    q = random_angles(90, 1)
    xyz = places(OTHER, q) + np.random.default_rng(2).normal(0, NOISE_MM, (len(q), 3))
    T = np.eye(4)
    T[:3, 3] = 1e3 * REFLECTOR_M
    target = Artefact("target", "target", (0,), np.zeros((1, 3)), np.ones(1))
    cell = Cell(arm.robot, T, (target,), (Station("tracker", "target"),), measurement=TARGET_IN_BASE)
    number = np.arange(len(q))
    return Observations(cell, number, np.zeros(len(q), int), q, number, np.zeros(len(q), int), xyz)


def test_the_written_model_stands_where_the_arm_does_at_poses_never_seen(arm, recorded):
    from mbcacq.simulation.poses import observations_of_model, run_poses, write_into_model

    cell = calibrate(observations_of_model(recorded, arm), CalibrationOptions(refuse=False))
    match = write_into_model(arm, cell, ())
    assert match.errors[0].after < 1e-6  # mm between MuJoCo's model and the calibrated cell
    q = random_angles(40, 3)
    spec = mujoco.MjSpec.from_string(match.xml)
    tool = np.linalg.inv(run_poses(arm, arm.spec, q[:1])[0]) @ arm.imported.T_given_base @ arm.robot.chain.flange(q[:1])[0]
    reflector = (tool @ cell.state.T_flange_scanner)[:3, 3]
    made = np.array([T[:3, :3] @ reflector + T[:3, 3] for T in run_poses(arm, spec, q)])
    true = places(OTHER, q)
    assert spread(made, true) < 2 * NOISE_MM
    nominal = np.array([T[:3, :3] @ (1e3 * REFLECTOR_M) + T[:3, 3] for T in run_poses(arm, arm.spec, q)])
    assert spread(nominal, true) > 0.3


FRAMED = ARM.replace(  # the same arm, with <frame> around a body, around two of them at once, and around a joint
    '<body name="link2" pos="0.15 0 0.2">', '<frame pos="0.15 0 0" euler="0 0 90"><body name="link2" pos="0 0 0.2" euler="0 0 -90">'
).replace('<body name="link3" pos="0 0 0.6" euler="0 5 0"><joint name="A3" axis="0 1 0" pos="0 0.02 0" range="-120 120"/>',
          '<frame pos="0 0 0.4"><frame pos="0 0 0.2"><body name="link3" euler="0 5 0"><frame pos="0 0.02 0" euler="90 0 0">'
          '<joint name="A3" axis="0 0 -1" range="-120 120"/></frame>').replace(
    "</body></body></body></body></body></body></body></worldbody>",
    "</body></body></body></body></frame></frame></body></frame></body></body></worldbody>",
)  # fmt: skip


def test_frames_around_bodies_and_joints_do_not_move_what_is_written(tmp_path):
    from mbcacq.simulation.mujoco_arm import load_arm
    from mbcacq.simulation.poses import run_poses
    from mbcacq.simulation.write_model import as_xml, with_chain

    q = random_angles(5, 6)
    assert places(FRAMED, q) == pytest.approx(places(ARM, q), abs=1e-6)
    path = tmp_path / "framed.xml"
    path.write_text(FRAMED)
    framed = load_arm(path)
    errors = np.random.default_rng(3).normal(size=(6, 5)) * [1e-3, 0.5, 0.5, 1e-3, 1e-3]
    chain = framed.robot.chain.with_errors(errors)
    written = with_chain(framed, chain)
    before, after = (T[:, -1] for T in (framed.robot.chain.frames(q), chain.frames(q)))
    T_base = framed.imported.T_given_base
    hand = np.linalg.inv(T_base @ before[0]) @ run_poses(framed, framed.spec, q[:1])[0]
    assert run_poses(framed, written, q) == pytest.approx(T_base @ after @ hand, abs=1e-6)
    again = mujoco.MjSpec.from_string(as_xml(framed, written))  # six digits are written
    assert run_poses(framed, again, q) == pytest.approx(T_base @ after @ hand, abs=0.01)


def spread(one, other):
    """rms distance (mm) of two sets of points after the best rigid motion."""
    a, b = one - one.mean(axis=0), other - other.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    return float(np.sqrt(np.mean(np.sum((a @ turn - b) ** 2, axis=1))))


def test_an_elastic_gear_of_the_model_sags_as_its_spring_says(arm, tmp_path):
    from mbcacq.simulation.mujoco_arm import load_arm
    from mbcacq.simulation.poses import windup

    path = tmp_path / "elastic.xml"
    path.write_text(re.sub(r'(<joint name="A2"[^>]*>)', r'\1<joint name="A2_gear" axis="0 1 0" stiffness="50000"/>', ROTORS))
    elastic = load_arm(path)
    assert elastic.joints == arm.joints  # the spring is no axis
    q = np.radians([[10.0, 0, 0, 0, 0, 0]])
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    gear = model.joint("A2_gear")
    data.qpos[[model.joint(j).qposadr[0] for j in elastic.joints]] = q[0]
    for _ in range(5):
        mujoco.mj_forward(model, data)
        data.qpos[gear.qposadr[0]] = -data.qfrc_bias[gear.dofadr[0]] / 50000
    assert abs(windup(elastic, elastic.spec, q)[0, 1] - data.qpos[gear.qposadr[0]]) < 1e-7
    assert abs(data.qpos[gear.qposadr[0]]) > 1e-4


def test_a_compliance_becomes_a_spring_and_a_rotor_that_mujoco_can_run(arm):
    from mbcacq.simulation import parameters

    spec = arm.spec.copy()
    gear = parameters.gear(arm, "A2", 4e-6, 1.0)
    gear.prepare(spec)
    gear.apply(spec, np.array([4e-6, 1e-3]))
    model = spec.compile()
    assert np.isclose(np.max(model.jnt_stiffness[model.joint("A2_gear").id]), 2.5e5)
    assert model.dof_armature[model.joint("A2").dofadr[0]] > 0


def test_other_simulators_poses_are_matched_by_their_angles_and_explained(arm, recorded):
    from mbcacq.simulation.simulated_sets import observations_against

    order = np.random.default_rng(4).permutation(recorded.n_poses)
    simulated = replace(recorded, q=recorded.q[order], xyz=places(ARM, recorded.q[order]) + 1e-4)
    left = observations_against(recorded, simulated)
    rest = calibrate(left, CalibrationOptions(refuse=False))
    assert np.abs(left.cell.robot.chain.a - arm.robot.chain.a).max() < 0.02  # the other simulator's geometry is the nominal one
    assert abs(rest.state.chain.d[3] - 649.3) < 0.1  # and the arm is explained against it


def test_simulated_poses_that_were_not_recorded_are_refused(recorded):
    from mbcacq.simulation.simulated_sets import observations_against

    with pytest.raises(ConfigError, match=r"no simulated pose .* simulated at .*as if one of them were in rad"):
        observations_against(recorded, replace(recorded, q=np.radians(recorded.q)))


def without_masses(robot):
    """The arm as a calibration without effects is exported: nobody stated its masses."""
    from mbcacq.exports.mjcf import mjcf

    return mjcf(robot.chain, np.eye(4))


def test_a_diagnosis_says_where_masses_of_an_exported_model_are_placeholders(recorded, tmp_path):
    from mbcacq.workflow.diagnose import diagnose

    path = tmp_path / "arm.mjcf.xml"
    path.write_text(without_masses(recorded.cell.robot))
    found = diagnose(recorded, simulation=path, workers=1)
    links = ", ".join(f"link_{k}" for k in range(1, 7))
    (note,) = [note for note in found.poses.notes if "placeholders" in note]
    assert note.startswith(f"in arm.mjcf.xml the masses of {links} are placeholders")
    assert f"Note: {note}." in found.text
    assert 'name="placeholder_mass_kg"' in found.simulation.xml  # what is written has them still


def test_a_mass_that_somebody_wrote_is_no_placeholder(recorded, tmp_path):
    from mbcacq.simulation.mujoco_arm import load_arm, remarks_on_masses

    path = tmp_path / "weighed.xml"
    path.write_text(without_masses(recorded.cell.robot).replace('mass="1" diaginertia="0.0025', 'mass="7.5" diaginertia="0.0025', 5))
    weighed = load_arm(path)
    (sentence,) = remarks_on_masses(weighed, weighed.spec)
    assert "the masses of link_6 are placeholders" in sentence
    assert any("the masses of link_6 are placeholders" in remark for remark in weighed.imported.remarks)


def test_a_model_of_somebody_else_has_no_placeholders(arm):
    from mbcacq.simulation.mujoco_arm import remarks_on_masses

    assert remarks_on_masses(arm, arm.spec) == ()


def urdf(joints):
    """A URDF of links on revolute joints (name, origin m, axis), on a foot that stands on the root link ``world``."""
    inertial = (
        '<inertial><mass value="5"/><origin xyz="0.1 0 0"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = ['<link name="world"/>', f'<link name="foot">{inertial}</link>']
    text = ['<joint name="stand" type="fixed"><parent link="world"/><child link="foot"/><origin xyz="0.4 0 0.3" rpy="0 0 0.5"/></joint>']
    parent = "foot"
    for name, origin, axis in joints:
        links.append(f'<link name="link_{name}">{inertial}</link>')
        text.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="link_{name}"/><origin xyz="{origin}"/>'
            f'<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="100" velocity="3"/></joint>'
        )
        parent = f"link_{name}"
    return f'<robot name="arm">{"".join(links)}{"".join(text)}</robot>'


def test_an_arm_from_a_urdf_whose_root_link_is_the_world_of_mujoco(tmp_path):
    """MuJoCo makes one body of world and root link. The last body moves as the imported chain says, up to a constant transform."""
    from mbcacq.simulation.mujoco_arm import load_arm
    from mbcacq.simulation.poses import run_poses
    from mbcacq.simulation.write_model import with_chain

    joints = [("A1", "0 0 0.2", "0 0 1"), ("A2", "0.15 0 0.2", "0 1 0"), ("A3", "0 0 0.6", "0 1 0")]
    joints += [("A4", "0.2 0 0.1", "1 0 0"), ("A5", "0.45 0 0", "0 1 0"), ("A6", "0.1 0 0", "1 0 0")]
    path = tmp_path / "arm.urdf"
    path.write_text(urdf(joints))
    arm = load_arm(path)
    q = random_angles(12, 3)
    expected = arm.imported.T_given_base @ arm.robot.chain.frames(q)[:, -1]
    for spec in (arm.spec, with_chain(arm, arm.robot.chain)):
        constant = np.linalg.inv(expected) @ run_poses(arm, spec, q)
        np.testing.assert_allclose(constant, np.broadcast_to(constant[0], constant.shape), atol=1e-6)
