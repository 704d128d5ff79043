"""Recorded motion beside the set that another simulator made for it; no simulator is needed to read one."""

from dataclasses import replace

import numpy as np
import pytest

from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories
from mbcacq.errors import ConfigError
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel
from mbcacq.model.trajectory import Trajectory
from mbcacq.simulation.simulated_sets import trajectory_against

TIME = np.arange(0, 8, 0.008)
Q = 0.8 * np.stack([np.sin(2.1 * TIME), np.sin(1.3 * TIME + 1)], axis=1)
SPEED = 0.8 * np.stack([2.1 * np.cos(2.1 * TIME), 1.3 * np.cos(1.3 * TIME + 1)], axis=1)


def motion(torque):
    zero = np.zeros(2)
    chain = Chain(np.ones(2), zero, np.array([300.0, 0.0]), np.array([0.0, 400.0]), np.array([np.pi / 2, 0.0]), zero)
    limits = np.tile([-np.pi, np.pi], (2, 1))
    robot = RobotModel("two", chain, limits, np.array([5.0, 4.0]), np.array([[0.0, 0.0, 100.0], [200.0, 0.0, 0.0]]))
    return Trajectory(robot, TIME, Q, torque=torque, name="recorded")


def simulated_torque():
    """A law that no rigid body has: only the comparison with the simulated set can explain it."""
    return 30 * np.sin(3 * Q) + 2 * SPEED


def test_friction_beyond_another_simulators_own_torque_is_found_with_its_size():
    noise = np.random.default_rng(0).normal(0, 0.05, Q.shape)
    friction = np.array([0.0, 3.0]) * np.sign(SPEED)
    recorded = trajectory_against(motion(simulated_torque() + friction + noise), motion(simulated_torque()))
    found = diagnose_trajectories([recorded], cross_validation=False)
    (effect,) = [e for e in found.named_effects if e.name == "friction"]
    assert effect.where == ("A2",)
    assert abs(effect.parameters["A2.coulomb_Nm"].value - 3.0) < 0.1


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda s: replace(s, q=np.degrees(s.q)), "as if one of them were in rad"),
        (lambda s: replace(s, time_s=s.time_s[::2], q=s.q[::2], torque=s.torque[::2]), "simulate at the recorded times"),
        (lambda s: replace(s, torque=None), "has neither torques"),
        (lambda s: replace(s, q=s.q[:, ::-1]), "from the simulated motion; simulate the recorded motion"),
    ],
)
def test_a_set_of_another_motion_is_refused(change, sentence):
    with pytest.raises(ConfigError, match=sentence):
        trajectory_against(motion(simulated_torque()), change(motion(simulated_torque())))
