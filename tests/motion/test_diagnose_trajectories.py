"""Simulated trajectories with a known truth, without the code under test: what is injected is named, nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories
from mbcacq.errors import ConfigError
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel
from mbcacq.model.trajectory import Trajectory

CHAIN = Chain(np.array([1.0, 1.0]), np.zeros(2), np.array([300.0, 0]), np.array([0.0, 700]), np.radians([-90.0, 0]), np.zeros(2))
ARM = RobotModel(
    "two axes",
    CHAIN,
    np.radians([[-170.0, 170]] * 2),
    np.array([10.0, 20]),
    np.array([[0.0, 0, 0], [-300, 0, 0]]),
    gear_ratio=np.array([100.0, 120.0]),
)
STEP = 0.004


def motion(seed, seconds=12.0):
    """Sums of sines: angle, rate, acceleration (T, 2) without numerical differentiation."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, STEP)
    rate, phase = rng.uniform(0.4, 3.0, (4, 2)), rng.uniform(0, 6.28, (4, 2))
    size = rng.uniform(0.1, 0.3, (4, 2)) / rate
    angle = rate * t[:, None, None] + phase
    return (
        t,
        (size * np.sin(angle)).sum(1),
        (size * rate * np.cos(angle)).sum(1),
        -(size * rate**2 * np.sin(angle)).sum(1),
        (size, rate, phase),
    )


def at(shape, t):
    size, rate, phase = shape
    return (size * np.sin(rate * np.asarray(t)[..., None, None] + phase)).sum(-2)


def torque(q, qd, qdd):
    """Drives of a vertical pendulum on a turntable, by Lagrange, point mass 20 kg at 0.4 m from axis 2. A2 > 0 lowers the arm."""
    m, r, g = 20.0, 0.4, 9.80665
    c, s = np.cos(q[:, 1]), np.sin(q[:, 1])
    first = m * r**2 * (c**2 * qdd[:, 0] - 2 * c * s * qd[:, 0] * qd[:, 1])
    second = m * r**2 * (qdd[:, 1] + c * s * qd[:, 0] ** 2) - m * g * r * c
    return np.stack([first, second], axis=1)


def recording(
    seed,
    *,
    latency=0.0,
    compliance=0.0,
    coulomb=0.0,
    viscous=0.0,
    transmission_error=0.0,
    clearance=0.0,
    noise=True,
    late_torque=0.0,
    torque_ripple=0.0,
    load_share=0.0,
    heavier=1.0,
    flank_s=None,
    seconds=12.0,
):
    rng = np.random.default_rng(1000 + seed)
    t, q, qd, qdd, shape = motion(seed, seconds)
    tau = heavier * torque(q, qd, qdd)
    late = at(shape, t - latency)
    flank = np.sign(qd) if flank_s is None else follow(np.sign(tau), flank_s)
    joint = late - compliance * tau + transmission_error * np.sin(20.0 * late + 0.5) - 0.5 * clearance * flank
    drive = tau + (coulomb + load_share * np.abs(tau)) * np.sign(qd) + viscous * qd + torque_ripple * np.sin(90.0 * q + 0.5)
    drive = CubicSpline(t, drive)(np.clip(t - late_torque, 0, t[-1]))
    noise = 1.0 if noise else 0.0
    q_joint = joint + noise * rng.normal(0, 2e-6, q.shape) + 0.001
    return Trajectory(ARM, t, q, q_joint=q_joint, torque=drive + noise * rng.normal(0, 0.3, q.shape))


def follow(signal, time_constant_s):
    keep = np.exp(-STEP / time_constant_s)
    return signal[0] + lfilter([1 - keep], [1, -keep], signal - signal[0], axis=0)


def named(result):
    return {(e.name, *e.where) for e in result.effects}


def value(result, name, key):
    return next(e for e in result.effects if e.name == name and key in e.parameters).parameters[key]


@pytest.fixture(scope="module")
def ideal():
    return diagnose_trajectories([recording(1), recording(2)])


def test_the_pendulum_of_this_test_agrees_with_the_rigid_body_model(ideal):
    """Two independent derivations of the same torque: the residual is the noise that was added."""
    for fit in ideal.fit.channels:
        if fit.channel == "tau":
            assert fit.held_out.before_rms == pytest.approx(0.3, rel=0.15)


def test_an_ideal_arm_shows_no_effect(ideal):
    assert ideal.verdict == "none"
    assert named(ideal) == set()


def test_latency_of_the_joint_encoder():
    result = diagnose_trajectories([recording(k, latency=0.003) for k in (1, 2)], cross_validation=False)
    found = value(result, "channel_latency", "latency_s")
    assert abs(found.value - 0.003) < max(3 * found.std, 2e-5)
    assert ("channel_latency", "q_joint") in named(result)


def test_torque_ripple_is_late_with_its_channel():
    """A delay that shifts a fast periodic component by half a radian leaves delay and amplitude alone."""
    result = diagnose_trajectories([recording(k, late_torque=0.004, torque_ripple=5.0) for k in (1, 2)], cross_validation=False)
    late = value(result, "channel_latency", "latency_s")
    assert abs(late.value - 0.004) < 3 * late.std < 2e-4
    for axis in ("A1", "A2"):
        found = value(result, "torque_ripple", f"{axis}.amplitude_Nm")
        assert abs(found.value - 5.0) < 3 * found.std < 0.2


def test_friction_grows_with_the_actual_load_not_with_the_described_one():
    result = diagnose_trajectories([recording(k, coulomb=5.0, load_share=0.15, heavier=1.08) for k in (1, 2)], cross_validation=False)
    for name, true in (("A2.load_dependent", 0.15), ("A2.coulomb_Nm", 5.0)):
        found = value(result, "friction", name)
        assert abs(found.value - true) < 3 * found.std


def test_what_gives_energy_is_no_friction():
    """A torque that is recorded with a wrong share of the speed: it has the form of friction, and drives the arm."""
    result = diagnose_trajectories([recording(k, coulomb=-4.0, viscous=-6.0) for k in (1, 2)], cross_validation=False)
    assert "friction" not in {name for name, *_ in named(result)}
    of_speed = {e.where: e for e in result.effects if e.name == "unknown"}
    assert {("A1",), ("A2",)} <= set(of_speed)
    one = of_speed["A1",]
    assert one.depends_on == "qd1"
    assert max(abs(y) for y in one.shape.y) == pytest.approx(4.0 + 6.0 * max(abs(x) for x in one.shape.x), rel=0.15)
    assert result.verdict == "unexplained"
    assert any(said.startswith("friction at A1 fits and is refused as a name") for said in result.suspicions)


def test_backlash_is_crossed_in_a_time_of_its_own():
    result = diagnose_trajectories([recording(k, clearance=1e-4, flank_s=0.012) for k in (1, 2)], cross_validation=False)
    width = value(result, "backlash", "A1.width_deg")
    assert abs(width.value - np.degrees(1e-4)) < 3 * width.std < 0.1 * np.degrees(1e-4)
    assert value(result, "backlash", "A1.crossing_s").value == pytest.approx(0.012, rel=0.3)


def test_wind_up_is_distinguished_from_friction_and_latency():
    runs = [recording(k, latency=0.002, compliance=2e-5, coulomb=8.0, viscous=15.0) for k in (1, 2)]
    result = diagnose_trajectories(runs, cross_validation=False)
    assert {("channel_latency", "q_joint"), ("joint_compliance", "A2"), ("friction", "A1"), ("friction", "A2")} <= named(result)
    wound = value(result, "joint_compliance", "A2.compliance_rad_per_Nm")
    assert abs(wound.value - 2e-5) < max(3 * wound.std, 4e-7)
    for axis in ("A1", "A2"):
        rub = value(result, "friction", f"{axis}.viscous_Nms_per_rad")
        assert abs(rub.value - 15.0) < max(3 * rub.std, 1.0)


def test_transmission_error_with_its_order():
    result = diagnose_trajectories([recording(k, transmission_error=3e-5) for k in (1, 2)], cross_validation=False)
    assert {("gear_transmission_error", "A1"), ("gear_transmission_error", "A2")} <= named(result)
    assert value(result, "gear_transmission_error", "A2.order").value == pytest.approx(20.0, abs=0.3)
    assert value(result, "gear_transmission_error", "A2.amplitude_deg").value == pytest.approx(np.degrees(3e-5), rel=0.1)


def test_backlash():
    result = diagnose_trajectories([recording(k, clearance=1e-4) for k in (1, 2)], cross_validation=False)
    assert {("backlash", "A1"), ("backlash", "A2")} <= named(result)
    assert value(result, "backlash", "A1.width_deg").value == pytest.approx(np.degrees(1e-4), rel=0.1)


def test_uneven_sampling_and_missing_channels():
    run = recording(3, latency=0.003)
    keep = np.random.default_rng(0).uniform(size=len(run.time_s)) > 0.05
    result = diagnose_trajectories([Trajectory(ARM, run.time_s[keep], run.q[keep], q_joint=run.q_joint[keep])])
    assert ("channel_latency", "q_joint") in named(result)
    assert result.fit.held_out.split == "time block"


def test_what_cannot_be_compared_is_refused():
    run = recording(1)
    with pytest.raises(ConfigError, match="nothing to compare"):
        diagnose_trajectories([Trajectory(ARM, run.time_s, run.q)])
    with pytest.raises(ConfigError, match="does not rise"):
        diagnose_trajectories([replace(run, time_s=run.time_s[::-1])])


def test_a_joint_that_stands_in_a_recording_does_not_change_its_friction():
    """There the drive gives anything up to the stiction, whichever way an encoder trembles."""
    runs = [recording(k, coulomb=8.0, viscous=15.0) for k in (1, 2)]
    still = recording(3)
    q = np.stack([still.q[:, 0], 0.3 + 1e-7 * np.random.default_rng(4).normal(size=len(still.q))], axis=1)
    rate = np.stack([np.gradient(q[:, 0], STEP), np.zeros(len(q))], axis=1)
    tau = torque(q, rate, np.stack([np.gradient(rate[:, 0], STEP), np.zeros(len(q))], axis=1))
    tau += np.stack([8.0 * np.sign(rate[:, 0]) + 15.0 * rate[:, 0], 6.0 * np.cos(still.time_s)], axis=1)
    runs.append(replace(still, q=q, q_joint=None, torque=tau + np.random.default_rng(5).normal(0, 0.3, q.shape)))
    result = diagnose_trajectories(runs, cross_validation=False)
    for axis in ("A1", "A2"):
        rub = value(result, "friction", f"{axis}.coulomb_Nm")
        assert abs(rub.value - 8.0) < 3 * rub.std < 1.0


@pytest.mark.parametrize(
    ("fault", "expected", "validated"),
    [
        ({}, set(), True),
        ({"coulomb": 3.0}, {("friction", "A1"), ("friction", "A2")}, False),  # its cross-validation takes ten times as long
        ({"compliance": 2e-5}, {("joint_compliance", "A2")}, True),
    ],
)
def test_recordings_without_any_noise_are_diagnosed(fault, expected, validated):
    """Another simulator's own output: the residual is zero to rounding, and what it holds is found all the same."""
    result = diagnose_trajectories([recording(k, noise=False, seconds=6.0, **fault) for k in (1, 2)], cross_validation=validated)
    assert expected <= named(result)
    assert all(np.isfinite(fit.held_out.after_rms) for fit in result.fit.channels)
