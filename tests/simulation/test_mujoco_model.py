"""Recordings against a MuJoCo model: what a second model conceals is found, and the first one then runs as recorded."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mbcacq.errors import ConfigError
from mbcacq.model.trajectory import Trajectory
from mbcacq.workflow.diagnose import DiagnosisResult, diagnose

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is in the extra mjcf")

STEP_S, TIMESTEP_S = 0.008, 0.004
NOISE = {"q": 3e-6, "torque": 0.05}


def arm(friction=(0.0, 0.0, 0.0), tool="", delay_s=0.0, gear="", servo=("400", "900", "300")):
    delayed = f'delay="{delay_s}" nsample="8" interp="linear"' if delay_s else ""
    joints = [f'<joint name="A{k + 1}" axis="{a}" armature="0.4" frictionloss="{f}" range="-170 170"/>'
              for k, (a, f) in enumerate(zip(("0 0 1", "0 1 0", "0 1 0"), friction, strict=True))]  # fmt: skip
    return f"""<mujoco><compiler angle="degree"/><option timestep="{TIMESTEP_S}" integrator="implicitfast"><flag contact="disable"/></option>
<default><joint damping="0.5"/></default><worldbody><body name="foot" pos="0 0 0.1">
<body name="link1" pos="0 0 0.2">{joints[0]}<inertial pos="0.02 0 0.05" mass="5" diaginertia="0.05 0.05 0.04"/>
<body name="link2" pos="0.05 0 0.1">{joints[1]}{gear}<inertial pos="0 0.01 0.2" mass="4" diaginertia="0.06 0.06 0.01"/>
<body name="link3" pos="0 0 0.4">{joints[2]}<inertial pos="0.15 0 0.01" mass="2" diaginertia="0.01 0.03 0.03"/>
{tool}</body></body></body></body></worldbody>
<actuator>{"".join(f'<position name="m{k}" joint="A{k + 1}" kp="{10 * int(s)}" kv="{s}"/>' for k, s in enumerate(servo))}</actuator>
<sensor>{"".join(f'<jointpos joint="A{k}"/>' for k in (1, 2, 3))}
{"".join(f'<jointactuatorfrc joint="A{k}" {delayed}/>' for k in (1, 2, 3))}</sensor></mujoco>"""


def set_points(seed, seconds):
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, STEP_S)
    fade = np.clip(np.minimum(t, t[-1] - t) / 0.5, 0, 1) ** 2
    angle = sum(
        rng.uniform(0.15, 0.3, 3) * np.sin(2 * np.pi * np.outer(t, rng.uniform(0.3, 1.0, 3)) + rng.uniform(0, 6, 3)) for _ in range(3)
    )
    return t, np.array([0.0, 0.6, 0.9]) + fade[:, None] * angle


def record(xml, seed, q_joint=False, seconds=2.0):
    """What a controller would log of the model, stepped one by one."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    t, command = set_points(seed, seconds)
    motors = [model.jnt_qposadr[model.joint(f"A{k}").id] for k in (1, 2, 3)]
    data.qpos[motors] = command[0]
    fine = CubicSpline(t, command)(np.arange(0, t[-1] + 1e-9, TIMESTEP_S))
    rows, wound = [], []
    for k in range(-100, len(fine)):
        data.ctrl[:] = fine[max(k, 0)]
        mujoco.mj_step(model, data)
        rows.append(np.array(data.sensordata))
        wound.append(data.qpos[model.joint("A2_gear").qposadr[0]] if q_joint else 0.0)
    rows = np.array(rows)[100 :: round(STEP_S / TIMESTEP_S)]
    rng = np.random.default_rng(seed + 50)
    q = rows[:, :3] + rng.normal(0, NOISE["q"], (len(rows), 3))
    torque = rows[:, 3:] + rng.normal(0, NOISE["torque"], (len(rows), 3))
    return t[: len(rows)], command[: len(rows)], q, torque


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "arm.xml"
    path.write_text(arm())
    return path


def trajectory(given, xml, seed, **of):
    from mbcacq.simulation.mujoco_arm import load_arm

    t, command, q, torque = record(xml, seed, **of)
    return Trajectory(load_arm(given).robot, t, q, q_set=command, torque=torque, name=f"motion{seed}")


TOOL = '<body name="tool" pos="0.3 0 0"><inertial pos="0.02 0.03 0" mass="1.5" diaginertia="0.004 0.004 0.004"/></body>'


@pytest.fixture(scope="module")
def concealed(given):
    xml = arm(friction=(4.0, 6.0, 2.5), tool=TOOL, delay_s=0.012)
    return [trajectory(given, xml, seed) for seed in (1, 2)]


@pytest.fixture(scope="module")
def found(given, concealed):
    return diagnose(concealed[:1], simulation=given, check=concealed[1:])


def value(found, name, where, parameter):
    (p,) = [p for p in found.simulation.parameters if (p.name, p.where, p.parameter) == (name, where, parameter)]
    return p


def test_concealed_friction_tool_and_delay_are_found_in_the_model(found):
    for joint, true in (("A1", 4.0), ("A2", 6.0), ("A3", 2.5)):
        p = value(found, "friction", joint, "frictionloss_Nm")
        assert abs(p.after - true) < max(5 * p.std, 0.02), p
    mass = value(found, "inertia", "link3", "mass_kg")
    assert abs(mass.before - 2.0) < 1e-9
    assert abs(mass.after - 3.5) < max(5 * mass.std, 0.02)
    delay = value(found, "sensor_delay", "tau", "delay_s")
    assert abs(delay.after - 0.012) < max(5 * delay.std, 5e-4)


def test_the_first_model_then_runs_as_recorded_where_nothing_was_learnt(found):
    assert found.verdict == "explained"
    (check,) = found.simulation.checks
    for e in check.errors:
        assert e.after < 1.15 * e.noise, e
        assert e.before > 5 * e.noise, e


def test_what_was_written_is_a_model_that_mujoco_runs(found, tmp_path):
    model = mujoco.MjModel.from_xml_path(str(found.simulation.write(tmp_path / "found.xml")))
    assert abs(model.dof_frictionloss[1] - 6.0) < 0.1
    assert abs(model.body("link3").mass[0] - 3.5) < 0.1


def test_the_diagnosis_pickles_and_comes_back_from_json(found):
    again = DiagnosisResult.from_json(json.dumps(pickle.loads(pickle.dumps(found)).to_dict()))
    assert again.simulation is not None
    assert again.simulation.xml == found.simulation.xml
    assert "frictionloss_Nm" in found.text


def test_a_model_that_agrees_is_left_as_it_is(given):
    found = diagnose([trajectory(given, arm(), 4)], simulation=given)
    assert found.simulation is not None
    assert found.simulation.parameters == ()
    assert found.verdict == "none"
    assert found.text.startswith("No effect")
    assert all(e.after < 1.2 * e.noise for e in found.simulation.errors)


def test_masses_that_the_model_calls_placeholders_are_named_beside_it(given, tmp_path):
    path = tmp_path / "exported.xml"
    path.write_text(arm().replace("<worldbody>", '<custom><numeric name="placeholder_mass_kg" data="4"/></custom><worldbody>'))
    found = diagnose([trajectory(given, arm(), 4)], simulation=path)
    (remark,) = found.simulation.remarks
    assert remark.startswith("in exported.xml the masses of link2 are placeholders")
    assert remark in found.text


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda t: replace(t, q=np.degrees(t.q)), "joint 'A1' of .* turns -170.0 to 170.0; the units"),
        (lambda t: replace(t, time_s=t.time_s * 0.7), "is no multiple of the timestep"),
        (lambda t: replace(t, time_s=t.time_s**1.2), "not evenly spaced"),
    ],
)
def test_a_recording_that_cannot_be_of_the_model_is_refused(given, concealed, change, sentence):
    with pytest.raises(ConfigError, match=sentence):
        diagnose([change(concealed[0])], simulation=given)


def test_another_number_of_axes_is_refused(given, concealed, tmp_path):
    two = tmp_path / "two.xml"
    two.write_text(
        '<mujoco><worldbody><body><joint name="A1"/><geom size="0.1"/><body pos="0 0 1"><joint name="A2" axis="0 1 0"/>'
        '<geom size="0.1"/></body></body></worldbody></mujoco>'
    )
    with pytest.raises(ConfigError, match=r"has 3 axes, .* has 2 \(A1, A2\)"):
        diagnose([concealed[0]], simulation=two)
