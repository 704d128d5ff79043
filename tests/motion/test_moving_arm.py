"""The fake arm in motion (MuJoCo bodies, drives with effects): what is injected is found, by name, location and size."""

import numpy as np
import pytest
import yaml

pytest.importorskip("mujoco")

from mbcacq_fakes.dynamics.bodies import Bodies
from mbcacq_fakes.dynamics.online import MovingArm, description
from mbcacq_fakes.dynamics.recorded import recorded
from motion_challenge import score_motion

from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories
from mbcacq.errors import ConfigError
from mbcacq.geometry.gravity import gravity_torque
from mbcacq.model import shipped
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.trajectory import Trajectory, moves


@pytest.fixture(scope="module")
def kr10():
    return RobotSpec.model_validate(yaml.safe_load(shipped.robot_file("kr10_r1100_2").read_text())).model()


def diagnosed(robot, injected, seed=7, seconds=4.0):
    recordings = [recorded(robot, injected, seed, motion, seconds) for motion in (0, 1)]
    trajectories = [Trajectory(robot, r.time_s, r.q, q_set=r.q_set, q_joint=r.q_joint, torque=r.torque) for r in recordings]
    return diagnose_trajectories(trajectories, cross_validation=False), recordings[0].truth


def test_two_engines_hold_the_same_weight(kr10):
    tool = np.array([5.0, 6, 70])
    bodies = Bodies(kr10.chain.sign, kr10.chain.rows, kr10.mass, kr10.com, (3.0, tool), kr10.gravity)
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (5, 6))
    pull = gravity_torque(kr10.chain, kr10.chain.frames(q), kr10.mass, kr10.com, 3.0, tool, kr10.gravity)
    for pose, torque in zip(q, pull, strict=True):
        np.testing.assert_allclose(bodies.at(pose, np.zeros(6))[1], -torque, atol=1e-3)


def test_an_arm_as_described_shows_nothing(kr10):
    diagnosis, _ = diagnosed(kr10, [], seconds=6.0)
    assert diagnosis.verdict == "none"
    assert diagnosis.effects == ()


def test_wind_up_friction_and_a_late_channel_together(kr10):
    """Friction loads the drive, not the gear: its torque must not appear as wind-up; a delay must not appear as either."""
    diagnosis, truth = diagnosed(
        kr10,
        [
            {"name": "joint_compliance", "where": "A3", "compliance_rad_per_Nm": 6e-6},
            {"name": "friction", "where": "A3", "kind": "plain"},
            {"name": "channel_latency", "where": "q_joint", "latency_s": 0.002},
        ],
    )
    score = score_motion(truth, [True] * 3, diagnosis)
    assert score.identified
    assert score.false_names == []
    assert len(score.sigmas) == 4
    assert max(score.sigmas.values()) < 4.0


def test_a_tool_that_is_not_described_and_a_torque_ripple(kr10):
    diagnosis, truth = diagnosed(kr10, [{"name": "payload", "mass_kg": 4.0}, {"name": "torque_ripple", "where": "A2"}])
    score = score_motion(truth, [True] * 2, diagnosis)
    assert score.identified
    assert score.false_names == []
    assert max(score.sigmas.values()) < 4.0


def test_torque_constant_of_a_current_follows_from_the_weight_of_the_arm(kr10):
    """Percent of a drive, in proportion to its torque: friction found in N m, without anyone having said what a percent is."""
    recording = recorded(kr10, [{"name": "friction", "where": "A2", "kind": "plain"}], 7, 0, 10.0)
    percent = recording.torque * np.array([0.2, 0.15, 0.4, 2.0, 2.0, 5.0])
    diagnosis = diagnose_trajectories(
        [Trajectory(kr10, recording.time_s, recording.q, current=percent, current_unit="percent")], cross_validation=False
    )
    found = next(e for e in diagnosis.effects if e.where == ("A2",))
    assert found.name == "friction"
    true = recording.truth[0]["parameters"]["A2.coulomb_Nm"]
    assert found.parameters["A2.coulomb_Nm"].value == pytest.approx(true, rel=0.08)


def test_an_unknown_effect_is_refused(kr10):
    with pytest.raises(ConfigError, match="'rust'"):
        recorded(kr10, [{"name": "rust"}], 1)


def test_an_option_that_a_fault_does_not_have_is_refused(kr10):
    rusty = {"name": "friction", "where": "A2", "rust": 1.0}
    for refuses in (lambda: recorded(kr10, [rusty], 1), lambda: description(kr10, [rusty], 1)):
        with pytest.raises(ConfigError, match="friction of a moving arm knows no option 'rust'"):
            refuses()


def torque_at_rest(robot, faults, q):
    """(n,) N m, the mean over a second of what the drives give to hold an arm at q."""
    arm = MovingArm(np.degrees(q).tolist(), 0.004, 0.02, description(robot, faults, 1))
    held = []
    for _ in range(250):
        arm.step(tuple(np.degrees(q)))
        held.append(arm.torque)
    return np.mean(held, axis=0)


def test_a_tool_and_a_balancer_of_a_moving_arm_weigh_what_they_are_said_to(kr10):
    q = np.radians([10.0, -60.0, 80.0, 30.0, 40.0, 0.0])
    frames, (mass, com) = kr10.chain.frames(q[None]), (kr10.payload_mass, kr10.payload_com)
    further, its_com = 4.0, np.array([50.0, -20.0, 100.0])
    both = (mass * com + further * its_com) / (mass + further)
    pull = gravity_torque(kr10.chain, frames, kr10.mass, kr10.com, mass + further, both, kr10.gravity)[0]
    faults = [{"name": "payload", "mass_kg": further, "com_mm": its_com.tolist()}]
    np.testing.assert_allclose(torque_at_rest(kr10, faults, q), -pull, atol=0.1)
    # Levers 1 and 0.2 about an axis by which the link has turned a quarter: a spring of length sqrt(1.04), unstretched at 0.5.
    spring = [1.0, 0.2, 300.0, 0.5, float(q[1])]
    lifts = 300.0 * 0.2 * (1 - 0.5 / np.sqrt(1.04))
    balanced = torque_at_rest(kr10, [*faults, {"name": "gravity_compensator", "spring": spring}], q)
    np.testing.assert_allclose(balanced, -pull - [0.0, lifts, 0.0, 0.0, 0.0, 0.0], atol=0.1)


def test_the_moves_of_a_run_are_cut_out_from_rest_to_rest(kr10):
    t = np.arange(0, 20, 0.004)
    q = np.zeros((len(t), 6))
    for start in (3.0, 11.0):  # two moves of 2 s with long rests
        share = np.clip((t - start) / 2.0, 0, 1)
        q[:, 1] += 0.3 * share**3 * (10 - 15 * share + 6 * share**2)
    found = moves(Trajectory(kr10, t, q))
    assert len(found) == 2
    assert [m.q[0, 1] for m in found] == pytest.approx([0.0, 0.3], abs=1e-3)
    assert [m.q[-1, 1] for m in found] == pytest.approx([0.3, 0.6], abs=1e-3)
    assert sum(len(m.q) for m in found) * 0.004 == pytest.approx(5.0, abs=0.7)
