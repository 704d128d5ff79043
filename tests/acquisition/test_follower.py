"""Following an arm that others move: when it counts as standing at a target, what is said meanwhile, and that nothing is commanded."""

from types import SimpleNamespace

import numpy as np
import pytest

from mbcacq.acquisition import events, follower
from mbcacq.acquisition.follower import Follower
from mbcacq.devices import DeviceTimeout, MotionLimits, RobotState
from mbcacq.plan.schema import FollowUse
from mbcacq.workflow.run import Operator

LIMITS = MotionLimits(*(np.ones(2) for _ in range(3)))
TARGET = np.radians([10.0, -20.0])
DEG = np.radians(1.0)


class Scripted:
    """An arm that shows one state after another, 0.1 s apart; the last for ever. It has no ``move_to``."""

    def __init__(self, *away_deg):
        self.states, self.time = [TARGET + np.radians(a) for a in away_deg], 0.0

    def state(self):
        self.time += 0.1
        q = self.states.pop(0) if len(self.states) > 1 else self.states[0]
        return RobotState(self.time, np.array(q), False, False)


class Ear:
    def __init__(self):
        self.said = []

    def state(self, state):
        pass

    def emit(self, kind, *values):
        assert (kind, values[0], values[2]) == (events.Message, "info", events.OPERATOR)
        self.said.append(values[1])


class Collector:
    def check(self):
        pass


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    """A computer's clock that only sleeping advances."""
    now = [0.0]
    monkeypatch.setattr(follower.time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    monkeypatch.setattr(follower.time, "monotonic", lambda: now[0])


def following(robot, **more):
    ear = Ear()
    return Follower(robot, LIMITS, Collector(), FollowUse(tolerance_deg=2.0, stand_s=1.0, **more), 0.01 * DEG, ear), ear


def test_it_is_taken_where_it_stands_and_how_far_off_is_said():
    robot = Scripted([30, 0], [10, 0], [1.5, -0.5])
    arm, ear = following(robot)
    reached = arm.go(TARGET)
    assert np.allclose(np.degrees(reached.q - TARGET), [1.5, -0.5])
    assert robot.time >= 0.3 + 1.0 - 1e-9  # it stood for a second by its own clock
    assert ear.said == ["bring the arm to A1 10.00° A2 -20.00°", "the arm stands 1.50° (A1) from its target"]
    assert arm.summary() == ", taken up to 1.50° from their targets"


def test_an_arm_that_creeps_does_not_stand():
    creeping = [[1.0 - 0.015 * k, 0] for k in range(60)]
    arm, _ = following(Scripted(*creeping))
    assert np.degrees(arm.go(TARGET).q - TARGET)[0] == pytest.approx(1.0 - 0.015 * 59)


def test_an_arm_that_passes_by_is_not_taken():
    arm, _ = following(Scripted([1, 0], [1, 0], [50, 0], [0.5, 0]))
    assert np.degrees(arm.go(TARGET).q - TARGET)[0] == pytest.approx(0.5)


def test_encoders_that_hum_stand():
    hum = [[0.003 * (-1) ** k, 0] for k in range(40)]
    robot = Scripted(*hum)
    following(robot)[0].go(TARGET)
    assert robot.time < 2.0


@pytest.mark.parametrize(("away", "sentence"), [([5, 0], "is 5.00° (A1) from it"), (None, "does not stand still near it")])
def test_an_arm_that_is_not_brought_there_ends_the_wait(away, sentence):
    states = [away] if away else [[(-1) ** k, 0] for k in range(100_000)]
    arm, ear = following(Scripted(*states), timeout_s=50.0)
    with pytest.raises(DeviceTimeout) as caught:
        arm.go(TARGET)
    assert sentence in str(caught.value)
    assert "within 50 s" in str(caught.value)
    assert len(ear.said) == 3  # at first, and every 20 s


def test_the_direction_of_arrival_is_seen():
    """Which flank of its gear an axis rests on follows from how it came, not from the hum of its encoder."""
    path = [[-30, 30], [-10, 10], [-1, 1], [1, 0.5], [0.5, 0.5], *[[0.5 + 0.002 * (-1) ** k, 0.5] for k in range(20)]]
    arm, _ = following(Scripted(*path))
    arm.go(TARGET)
    assert arm.direction.tolist() == [-1, -1]


def test_ways_are_up_to_whoever_moves_it():
    robot = Scripted([90, 90])
    following(robot)[0].pass_by(TARGET)
    assert robot.time == 0.0


def test_ctrl_c_leaves_the_wait_and_commands_nothing():
    class Interrupted(Scripted):
        def state(self):
            if self.time > 1.0:
                raise KeyboardInterrupt
            return super().state()

    arm, ear = following(Interrupted([30, 0]))  # which has neither move_to nor stop
    with pytest.raises(KeyboardInterrupt):
        arm.go(TARGET)
    assert len(ear.said) == 1


@pytest.mark.parametrize("follow", [None, FollowUse()])
def test_only_an_arm_that_is_driven_is_asked_about(follow, monkeypatch):
    monkeypatch.setattr("mbcacq.workflow.run.refuse_unattended", lambda loaded, assume_yes: None)  # no device that asks a person
    plan = SimpleNamespace(robot=SimpleNamespace(follow=follow))
    poses = [SimpleNamespace(number=k) for k in range(3)]
    acquisition = SimpleNamespace(loaded=SimpleNamespace(plan=plan), poses=poses, done=frozenset({0}), sweep=lambda: "swept")
    asked = []
    Operator(allow_motion=lambda loaded, remaining, sweep: asked.append(len(remaining))).allow(acquisition)
    assert asked == ([2] if follow is None else [])
