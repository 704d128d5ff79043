"""Each effect of motion against a closed form or an integration written here: a wrong sign or unit in its file fails."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbcacq.diagnosis.motion.signals import prepare
from mbcacq.effects import catalogue
from mbcacq.effects.kinds import (
    backlash,
    channel_latency,
    drive_lag,
    friction,
    gravity_compensator,
    joint_compliance,
    joint_scale,
    payload,
    wrist_coupling,
)
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals
from mbcacq.effects.motion_periods import periodic_component
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel
from mbcacq.model.trajectory import Trajectory

STEP, N = 0.001, 6
TIME = STEP * np.arange(8000)
RATE = np.array([0.9, 1.3, 1.7, 2.1, 2.6, 3.1])
SIZE = np.array([0.8, 0.6, 0.5, 0.7, 0.4, 0.9])
PHASE = np.array([0.2, 0.9, 1.7, 2.6, 3.3, 4.1])


def angle(t):
    return SIZE * np.sin(RATE * np.asarray(t)[:, None] + PHASE)


Q = angle(TIME)
QD = SIZE * RATE * np.cos(RATE * TIME[:, None] + PHASE)
QDD = -(RATE**2) * Q
LOAD = 40.0 * np.sin(1.1 * TIME[:, None] + np.arange(N)) + 15.0


def signals(**other):
    return MotionSignals(STEP, Q, QD, QDD, np.sign(QD), Q, **other)


def group(name, joints=tuple(range(N))):
    shape = (len(TIME), len(joints))
    unit = "N m" if name == "tau" else "rad"
    return ChannelGroup(
        name=name,
        unit=unit,
        joints=joints,
        mismatch=(np.zeros(shape),),
        use=(np.ones(shape, bool),),
        base=(np.zeros((*shape, 0)),),
        prior=np.zeros(0),
        refit=True,
        axes=tuple(f"A{k + 1}" for k in range(N)),
    )


def candidate(module, channel, run, where, form=""):
    found = [c for c in module.motion_candidates(group(channel), (run,)) if c.where == where and c.variant == form]
    assert len(found) == 1
    return found[0]


def fitted(chosen, run, joint, mismatch, hyper=None, use=slice(None)):
    """Parameters that the columns of a candidate give for a mismatch (T,), and the largest residual."""
    columns = chosen.rows.columns(run, joint, hyper)
    c = np.linalg.lstsq(columns[use], mismatch[use], rcond=None)[0]
    reported = chosen.parameters(c, np.zeros((len(c), len(c))), hyper)
    return {key: entry.value for key, entry in reported.items()}, np.abs(columns[use] @ c - mismatch[use]).max()


def check_joint_scale():
    """A joint side that moves 0.02 % further than the motor side."""
    found, residual = fitted(candidate(joint_scale, "q_joint", signals(), ("A2",)), signals(), 1, 1.0002 * Q[:, 1] - Q[:, 1])
    assert found == pytest.approx({"A2.ratio": 2e-4})
    assert residual < 1e-12


def check_wrist_coupling():
    """A6 follows 0.03 % of the rotation of A4."""
    chosen = candidate(wrist_coupling, "q_joint", signals(), ("A4", "A6"))
    assert chosen.rows.joints == (5,)
    found, _ = fitted(chosen, signals(), 5, 3e-4 * Q[:, 3])
    assert found == pytest.approx({"ratio": 3e-4})


def check_joint_compliance():
    """A flywheel behind a spring: its steady oscillation is ahead of the motor in amplitude, and its torque is inertia times acceleration."""
    stiffness, inertia = 2e5, 30.0
    link = Q[:, 1] / (1.0 - RATE[1] ** 2 * inertia / stiffness)
    torque = inertia * -(RATE[1] ** 2) * link
    run = signals(load=np.tile(torque[:, None], N))
    found, residual = fitted(candidate(joint_compliance, "q_joint", run, ("A2",)), run, 1, link - Q[:, 1])
    assert found == pytest.approx({"A2.compliance_rad_per_Nm": 1 / stiffness})
    assert residual < 1e-12


def check_backlash():
    """A link that is dragged along: it moves when a flank touches, half the clearance behind the motor."""
    width = 1e-3
    link = [Q[0, 2] - 0.5 * width * np.sign(QD[0, 2])]
    for motor in Q[1:, 2]:
        link.append(min(max(link[-1], motor - 0.5 * width), motor + 0.5 * width))
    touching = np.abs(QD[:, 2]) > 0.1 * np.abs(QD[:, 2]).max()
    found, residual = fitted(candidate(backlash, "q_joint", signals(), ("A3",)), signals(), 2, np.array(link) - Q[:, 2], use=touching)
    assert found == pytest.approx({"A3.width_deg": np.degrees(width)}, rel=1e-6)
    assert residual < 1e-9


def check_backlash_of_a_load():
    """The load changes its sign once: the link lags on the side of the load, and crosses the clearance exponentially."""
    width, crossing = 1e-3, 0.01
    load = np.where(TIME < 3.9995, 50.0, -50.0)
    since = np.maximum(TIME - 3.9995, 0.0)
    side = np.where(TIME < 3.9995, 1.0, 2.0 * np.exp(-since / crossing) - 1.0)
    run = signals(load=np.tile(load[:, None], N))
    found, residual = fitted(candidate(backlash, "q_joint", run, ("A3",), "load"), run, 2, -0.5 * width * side, crossing)
    assert found == pytest.approx({"A3.width_deg": np.degrees(width), "A3.crossing_s": crossing}, rel=1e-3)
    assert residual < 0.05 * width


def check_gear_transmission_error():
    error = np.radians(0.004) * np.sin(37.0 * Q[:, 1] + np.radians(50.0))
    chosen = periodic_component(catalogue.periodic_in("q_joint"), 1, "A2", 37.0, 0.1, 1.0, (-2.0, 2.0))
    found, _ = fitted(chosen, signals(), 1, error, 37.0)
    assert chosen.name == "gear_transmission_error"
    assert found == pytest.approx({"A2.order": 37.0, "A2.amplitude_deg": 0.004, "A2.phase_deg": 50.0})


def check_torque_ripple():
    torque = 6.0 * np.sin(90.0 * Q[:, 1] - np.radians(20.0))
    chosen = periodic_component(catalogue.periodic_in("tau"), 1, "A2", 90.0, 0.1, 1.0, (-2.0, 2.0))
    found, _ = fitted(chosen, signals(), 1, torque, 90.0)
    assert chosen.name == "torque_ripple"
    assert found == pytest.approx({"A2.order": 90.0, "A2.amplitude_Nm": 6.0, "A2.phase_deg": -20.0})


def check_friction():
    """The drive must give more in the direction of the motion: 12 N m, and 7 N m at one rad/s."""
    run = signals(rigid=LOAD, torque=LOAD)
    lost = np.where(QD[:, 3] > 0, 12.0, -12.0) + 7.0 * QD[:, 3]
    found, _ = fitted(candidate(friction, "tau", run, ("A4",)), run, 3, lost)
    assert found == pytest.approx({"A4.coulomb_Nm": 12.0, "A4.viscous_Nms_per_rad": 7.0})
    bump = np.where(QD[:, 3] > 0, 5.0, -5.0) / np.exp((QD[:, 3] / 0.2) ** 2)
    found, _ = fitted(candidate(friction, "tau", run, ("A4",), "stribeck"), run, 3, bump, 0.2)
    assert found == pytest.approx({"A4.stribeck_Nm": 5.0, "A4.stribeck_speed_rad_per_s": 0.2})
    loaded = np.where(QD[:, 3] > 0, 0.1, -0.1) * np.abs(LOAD[:, 3])
    found, _ = fitted(candidate(friction, "tau", run, ("A4",), "load"), run, 3, loaded)
    assert found == pytest.approx({"A4.load_dependent": 0.1})
    uneven = np.where(QD[:, 3] > 0, 3.0 + 2.0 * QD[:, 3], 3.0 - 2.0 * QD[:, 3])  # 3 N m more one way, 3 N m less the other
    found, _ = fitted(candidate(friction, "tau", run, ("A4",), "direction"), run, 3, uneven)
    assert found == pytest.approx({"A4.coulomb_uneven_Nm": 3.0, "A4.viscous_uneven_Nms_per_rad": 2.0})


def check_payload():
    """A point mass on a turntable with a vertical pendulum, by Lagrange: 5 kg, 60 mm beyond the flange, which is 0.7 m from axis 2."""
    mass, offset, g = 5.0, 0.06, 9.80665
    chain = Chain(np.array([1.0, 1.0]), np.zeros(2), np.array([300.0, 0]), np.array([0.0, 700]), np.radians([-90.0, 0]), np.zeros(2))
    arm = RobotModel("two axes", chain, np.radians([[-170.0, 170]] * 2), np.array([10.0, 20]), np.zeros((2, 3)))
    q, qd, qdd = Q[::2, :2], QD[::2, :2], QDD[::2, :2]
    run = prepare(Trajectory(arm, TIME[::2], q, torque=np.zeros_like(q)))[0]
    r, c, s = 0.7 + offset, np.cos(q[:, 1]), np.sin(q[:, 1])
    first = mass * r**2 * (c**2 * qdd[:, 0] - 2 * c * s * qd[:, 0] * qd[:, 1])
    second = mass * r**2 * (qdd[:, 1] + c * s * qd[:, 0] ** 2) - mass * g * r * c
    chosen = payload.motion_candidates(
        ChannelGroup(
            name="tau", unit="N m", joints=(0, 1), mismatch=(q,), use=(q > 9,), base=(q[:, :, None],), prior=np.zeros(1), refit=False
        ),
        (run,),
    )[0]
    assert chosen.where == ("mount",)
    # mass, first moment, then the tensor about the flange: a point on its x axis has two equal moments
    inertial = mass * np.array([1.0, offset, 0, 0, *(offset**2 * np.array([0, 0, 0, 1, 0, 1]))])
    for joint, torque in ((0, first), (1, second)):
        np.testing.assert_allclose((chosen.rows.columns(run, joint, None) @ inertial)[100:-100], torque[100:-100], atol=1e-2)
    reported = chosen.parameters(inertial, np.zeros((10, 10)))
    assert reported["mass_kg"].value == mass
    assert reported["com_mm"].value == pytest.approx([60.0, 0.0, 0.0])


def check_gravity_compensator():
    """The drive's share of a spring is the slope of its energy; one without free length is a sine of k a b."""
    k, a, b, q0 = 9e3, 0.35, 0.12, 0.3
    run = signals(gravity=LOAD)

    def energy(q, free):
        return 0.5 * k * (np.sqrt(a * a + b * b - 2 * a * b * np.cos(q - q0)) - free) ** 2

    def slope(free):
        return (energy(Q[:, 1] + 1e-5, free) - energy(Q[:, 1] - 1e-5, free)) / 2e-5

    first = candidate(gravity_compensator, "tau", run, ("A2",), "series")
    found, residual = fitted(first, run, 1, slope(0.0))
    expected = {"A2.sin_Nm": k * a * b * np.cos(q0), "A2.cos_Nm": -k * a * b * np.sin(q0), "A2.sin2_Nm": 0.0, "A2.cos2_Nm": 0.0}
    assert found == pytest.approx(expected, abs=1e-2)
    assert residual < 1e-3
    assert fitted(first, run, 1, slope(0.2))[1] < 0.03 * np.ptp(slope(0.2))
    third, _ = fitted(candidate(gravity_compensator, "tau", run, ("A2",), "third"), run, 1, 4.0 * np.sin(3 * Q[:, 1]))
    assert third == pytest.approx({"A2.sin3_Nm": 4.0, "A2.cos3_Nm": 0.0})


def check_drive_lag():
    """Dead time and lag turn a sine into a smaller and later one; the start, where the filters settle, is left out."""
    dead, lag = 0.008, 0.012
    q = SIZE / np.hypot(1.0, RATE * lag) * np.sin(RATE * (TIME[:, None] - dead) + PHASE - np.arctan(RATE * lag))
    run = MotionSignals(STEP, q, QD, QDD, np.sign(QD), q, q_set=Q, qd_set=QD, qdd_set=QDD, qddd_set=-(RATE**2) * QD)
    found, residual = fitted(candidate(drive_lag, "q_set", run, ("A2",), "fast"), run, 1, (q - Q)[:, 1], lag, slice(200, None))
    assert found == pytest.approx({"A2.latency_s": dead, "A2.time_constant_s": lag}, rel=1e-2)
    assert residual < 0.01 * np.abs(q - Q)[:, 1].max()


SLOW = [
    ("slow", "speed_gain", 0.05),
    ("friction", "friction_push_rad_per_s", 2e-3),
    ("drive", "drive_push_rad_per_Nms", 1e-5),
    ("load", "load_push_rad_per_Nms", 1e-5),
]


@pytest.mark.parametrize(("form", "name", "true"), SLOW)
def test_disturbance_of_a_slow_loop(form, name, true):
    """The deviation e of a loop that a disturbance d pushes aside, from rest: de/dt = -e / T + d, integrated here."""
    T, lead, size, rate = 2.0, 0.01, 2.0, 1.3

    def motion(t):
        """Set point, speed and acceleration that begin at zero."""
        return size * (rate * t - np.sin(rate * t)), size * rate * (1 - np.cos(rate * t)), size * rate**2 * np.sin(rate * t)

    def load(t):
        return 40.0 * np.sin(1.1 * t + 1.0) + 15.0

    def disturbance(t):
        _, qd, qdd = motion(t)
        by_form = {"slow": true * qd + lead * qdd, "friction": true, "drive": true * (load(t) + 5.0), "load": true * load(t)}
        return by_form[form]

    solved = solve_ivp(lambda t, e: -e / T + disturbance(t), (0.0, TIME[-1]), [0.0], t_eval=TIME, max_step=0.01, rtol=1e-8, atol=1e-12)
    q_set, qd, qdd = (np.tile(x[:, None], N) for x in motion(TIME))
    q = q_set + solved.y[0][:, None]
    torque = np.tile(load(TIME)[:, None], N)
    rates = {"q_set": q_set, "qd_set": qd, "qdd_set": qdd, "qddd_set": np.zeros_like(qd)}
    run = MotionSignals(STEP, q, qd, qdd, np.sign(qd), q, **rates, torque=torque + 5.0, rigid_set=torque)
    found, residual = fitted(candidate(drive_lag, "q_set", run, ("A2",), form), run, 1, solved.y[0], T)
    assert found[f"A2.{name}"] == pytest.approx(true, rel=2e-2)
    assert residual < 0.02 * np.abs(solved.y[0]).max()
    if form == "slow":
        assert found["A2.latency_s"] == pytest.approx(-lead, rel=1e-2)
        assert found["A2.time_constant_s"] == T


def check_channel_latency():
    """A channel that is 0.1 ms late shows what was true 0.1 ms ago."""
    late = 1e-4
    chosen = candidate(channel_latency, "q_joint", signals(), ("q_joint",))
    found, _ = fitted(chosen, signals(), 1, (angle(TIME - late) - Q)[:, 1], 0.0)
    assert found == pytest.approx({"latency_s": late}, rel=1e-2)
    run = signals(torque=LOAD)
    then = 40.0 * np.sin(1.1 * (TIME[:, None] - late) + np.arange(N)) + 15.0
    found, _ = fitted(candidate(channel_latency, "tau", run, ("tau",)), run, 1, (then - LOAD)[:, 1], 0.002)
    assert found == pytest.approx({"latency_s": late + 0.002}, rel=1e-2)  # added to what was corrected already


CHECKS = {
    "joint_scale": [check_joint_scale],
    "wrist_coupling": [check_wrist_coupling],
    "joint_compliance": [check_joint_compliance],
    "backlash": [check_backlash, check_backlash_of_a_load],
    "gear_transmission_error": [check_gear_transmission_error],
    "torque_ripple": [check_torque_ripple],
    "friction": [check_friction],
    "payload": [check_payload],
    "gravity_compensator": [check_gravity_compensator],
    "drive_lag": [check_drive_lag],
    "channel_latency": [check_channel_latency],
}


@pytest.mark.parametrize("check", [check for checks in CHECKS.values() for check in checks], ids=lambda check: check.__name__)
def test_effect_against_a_closed_form(check):
    check()


def in_motion(name):
    declared = catalogue.declaration(name)
    return hasattr(catalogue.effects()[name], "motion_candidates") or declared.periodic_in_motion is not None


def test_every_effect_of_motion_has_a_closed_form_here():
    names = {name for name in catalogue.effects() if in_motion(name)}
    assert names == set(CHECKS)
