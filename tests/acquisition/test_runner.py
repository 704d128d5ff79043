"""The runner: order of events, means, and a robot at rest whatever happens."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stand_ins import Finder, JumpingRobot, Placer, StillScanner

from mbcacq import devices
from mbcacq.acquisition import events
from mbcacq.acquisition.cell_devices import CellDevices
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.expected_view import predicted_centres
from mbcacq.acquisition.runner import Runner
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Artefact, Cell, RobotModel, Station
from mbcacq.plan import LoadedPlan, PlannedPose, Transit
from mbcacq.plan.motion_limits import arms_beyond, check_target, longest_duration, motion_limits
from mbcacq.plan.schema import Plan
from mbcacq.recording.run_folder.journal import Journal, recorded_facts
from mbcacq.report.sources.run_folder import read_run_info

CHAIN = Chain(
    np.array([-1.0, 1, 1, -1, 1, -1]),
    np.radians([0.0, 0, -90, 0, 0, 180]),
    np.array([400.0, 0, 0, 515, 0, 90]),
    np.array([25.0, 560, 25, 0, 0, 0]),
    np.radians([-90.0, 0, -90, 90, -90, 180]),
    np.zeros(6),
)
BALLS = Artefact("mbc", "", (1, 2, 3, 4), np.array([[0.0, 0, 0], [20, 0, 0], [0, 30, 0], [0, 0, 40]]), np.full(4, 12.0))


@pytest.fixture
def world():
    robot = RobotModel("arm", CHAIN, np.radians([[-170.0, 170]] * 6), np.zeros(6), np.zeros((6, 3)), speed=np.ones(6))
    stations = tuple(Station(s, "mbc", se3.from_abc(np.array([600.0, 0, 100 * k]), np.zeros(3))) for k, s in enumerate("ab"))
    cell = Cell(robot, np.eye(4), (BALLS,), stations)
    plan = Plan.model_validate(
        {
            "format": "mbcacq-plan/1",
            "name": "test",
            "robot": {"driver": "x", "model": "x", "home_deg": [0, -90, 90, 0, 0, 0]},
            "scanner": {
                "driver": "x",
                "field_of_view": {"near_z_mm": 50, "far_z_mm": -50, "near_half_mm": [40, 40], "far_half_mm": [50, 50]},
            },
            "hand_eye": {},
            "artefacts": ["mbc.yaml"],
            "stations": [{"id": "a", "artefact": "mbc", "pose_in_base": {}}],
            "steps": [{"do": "joints", "name": "s", "phase": "position", "station": "a", "poses_deg": [[0] * 6]}],
        }
    )
    given = {"step_name": "s", "phase": "position", "artefact": "mbc", "balls": (1, 2, 3, 4), "exposures": 3, "line": 9}
    poses = [PlannedPose(number=k, step=k // 2, station="ab"[k // 2], q=np.full(6, 0.1 * (k + 1)), **given) for k in range(4)]
    return LoadedPlan(Path("plan.yaml"), plan, cell, "text", {}), poses


HOME = np.radians([0.0, -90, 90, 0, 0, 0])


class Recorded:
    def __init__(self):
        self.events = []

    def __call__(self, event):
        self.events.append(event)

    def of(self, kind):
        return [e for e in self.events if isinstance(e, kind)]


def make(world, **changes):
    loaded, poses = world
    parts = {"robot": JumpingRobot(), "scanner": StillScanner(), "positioner": Placer(), "finder": Finder(), "done": frozenset()}
    parts |= {"facts": {}} | changes
    seen = Recorded()
    runner = Runner(
        loaded=loaded,
        poses=poses,
        paths=[Transit()] * len(poses),
        path_home=[HOME],
        devices=CellDevices(parts["robot"], parts["scanner"], parts["positioner"]),
        bus=EventBus([seen]),
        find_balls=parts["finder"],
        cell_yaml="cell",
        done=parts["done"],
        facts=parts["facts"],
    )
    return runner, seen, parts


def test_every_pose_is_observed_once_and_in_order(world):
    runner, seen, parts = make(world)
    runner.run()
    assert [e.pose for e in seen.of(events.PoseDone)] == [0, 1, 2, 3]
    assert [e.station for e in seen.of(events.StationReached)] == ["a", "b"]
    assert [e.index for e in seen.of(events.StepStarted)] == [0, 1]
    assert len(seen.of(events.ScanTaken)) == 12
    assert seen.events[-1].exit_status == "success"
    assert parts["robot"].log[-2:] == ["stop", "close"]


def test_the_observation_is_the_mean_of_the_exposures(world):
    runner, seen, _ = make(world)
    runner.run()
    loaded, poses = world
    done = seen.of(events.PoseDone)[0]
    np.testing.assert_allclose(done.xyz, predicted_centres(loaded.cell, poses[0]) + 0.02, atol=1e-12)
    np.testing.assert_allclose(done.scatter_mm, 0.01, atol=1e-12)
    np.testing.assert_allclose(done.q, poses[0].q)


def test_no_cycle_is_lost(world):
    runner, seen, parts = make(world)
    runner.run()
    times = np.concatenate([e.cycles.columns["time_s"] for e in seen.of(events.CyclesReceived)])
    assert times.tolist() == [0.5 * k for k in range(1, len(times) + 1)]
    assert times[-1] == parts["robot"].time


def test_direction_is_that_of_the_last_motion(world):
    loaded, poses = world
    back = [*poses[:2], replace(poses[2], q=np.array([0.2, 0.1, 0.3, 0.2, 0.2, 0.2]))]
    runner, seen, _ = make((loaded, back))
    runner.run()
    last = seen.of(events.PoseDone)[-1]
    assert last.direction.tolist() == [1, -1, 1, 1, 1, 1]


def test_the_run_starts_and_ends_at_home(world):
    runner, _, parts = make(world)
    runner.run()
    assert parts["robot"].targets[0].tolist() == parts["robot"].targets[-1].tolist() == HOME.tolist()


def test_a_device_fault_stops_the_robot_and_ends_the_run(world):
    scanner = StillScanner()
    scanner.fault = devices.DeviceTimeout("the scanner fell silent")
    runner, seen, parts = make(world, scanner=scanner)
    with pytest.raises(devices.DeviceTimeout):
        runner.run()
    assert parts["robot"].log[-1] == "close"
    assert "stop" in parts["robot"].log
    assert (seen.events[-1].exit_status, seen.events[-1].reason) == ("fail", "the scanner fell silent")


def test_the_arm_is_stopped_before_the_rest_is_tidied_up(world):
    class Noting(JumpingRobot):
        def cycles(self):
            self.log.append("cycles")
            return super().cycles()

    scanner = StillScanner()
    scanner.fault = devices.DeviceTimeout("the scanner fell silent")
    runner, _, parts = make(world, scanner=scanner, robot=Noting())
    with pytest.raises(devices.DeviceTimeout):
        runner.run()
    log = parts["robot"].log
    assert "cycles" in log[log.index("stop") :]


def test_interrupt_while_connecting_closes_what_is_connected(world, monkeypatch):
    scanner = StillScanner()
    monkeypatch.setattr(scanner, "connect", lambda: (_ for _ in ()).throw(KeyboardInterrupt()))
    runner, seen, parts = make(world, scanner=scanner)
    with pytest.raises(KeyboardInterrupt):
        runner.run()
    assert parts["robot"].log[-1] == "close"
    assert seen.events[-1].exit_status == "abort"


def test_interrupt_is_an_abort(world):
    scanner = StillScanner()
    scanner.fault = KeyboardInterrupt()
    runner, seen, parts = make(world, scanner=scanner)
    with pytest.raises(KeyboardInterrupt):
        runner.run()
    assert seen.events[-1].exit_status == "abort"
    assert "stop" in parts["robot"].log


def test_a_wrong_artefact_ends_the_run_with_what_was_measured_kept(world):
    class WrongLater(Finder):
        def __call__(self, *args, **kwargs):
            self.seen = -1 if self.calls >= 3 else None
            return super().__call__(*args, **kwargs)

    runner, seen, _ = make(world, finder=WrongLater())
    with pytest.raises(devices.DeviceFault, match="wrong artefact"):
        runner.run()
    assert [e.pose for e in seen.of(events.PoseDone)] == [0]


def test_poses_with_too_few_balls_are_left_out_then_end_the_run(world):
    finder = Finder()
    finder.seen = 2
    runner, seen, _ = make(world, finder=finder)
    with pytest.raises(devices.DeviceFault, match="too few balls"):
        runner.run()
    assert not seen.of(events.PoseDone)
    assert seen.of(events.Message)[-1].level == "warning"


def test_resume_skips_what_is_done(world):
    runner, seen, _ = make(world, done=frozenset({0, 2}))
    runner.run()
    assert [e.pose for e in seen.of(events.PoseDone)] == [1, 3]


def test_every_device_that_fails_to_connect_is_named(world):
    class Absent(StillScanner):
        def connect(self):
            raise devices.ConnectError("nothing answers at 192.168.1.10:3190")

    class Lost(Placer):
        def connect(self):
            raise devices.ConnectError("no positioner on /dev/ttyUSB0")

    runner, seen, parts = make(world, scanner=Absent(), positioner=Lost())
    with pytest.raises(devices.ConnectError, match=r"192\.168\.1\.10.*ttyUSB0"):
        runner.run()
    assert "move" not in parts["robot"].log
    assert parts["robot"].log[-1] == "close"


def test_an_arm_that_never_arrives_is_stopped(world):
    robot = JumpingRobot()
    robot.arrives = False
    runner, _, _ = make(world, robot=robot)
    with pytest.raises(devices.SafetyStop, match="did not arrive"):
        runner.run()
    assert robot.log[-2:] == ["stop", "close"]


@pytest.mark.parametrize("angle", [np.nan, np.inf, 3.0, -3.0])
def test_no_target_outside_the_limits_is_ever_sent(angle):
    target = np.zeros(6)
    target[4] = angle
    with pytest.raises(devices.SafetyStop, match="A5"):
        check_target(target, RobotModel("arm", CHAIN, np.radians([[-170.0, 170]] * 6), np.zeros(6), np.zeros((6, 3))))


def test_a_refused_confirmation_moves_nothing(world):
    def refuse(q):
        raise devices.Aborted("no")

    runner, seen, parts = make(world)
    runner.confirm = refuse
    with pytest.raises(devices.Aborted):
        runner.run()
    assert "move" not in parts["robot"].log
    assert seen.events[-1].exit_status == "abort"


def test_an_error_while_recording_reaches_the_runner(world):
    runner, _, parts = make(world)

    def full(event):
        if isinstance(event, events.CyclesReceived):
            raise devices.MbcacqError("disk full")

    runner.bus._subscribers.append(full)
    with pytest.raises(devices.MbcacqError, match="disk full"):
        runner.run()
    assert "stop" in parts["robot"].log


def test_a_failing_subscriber_keeps_the_event_from_no_other():
    seen = Recorded()

    def full(event):
        raise devices.MbcacqError("disk full")

    bus = EventBus([full, seen])
    with pytest.raises(devices.MbcacqError, match="disk full"):
        bus.emit(events.StateChanged, "moving")
    assert [e.state for e in seen.events] == ["moving"]


def test_a_wrong_setting_ends_the_wait_for_the_other_devices(world):
    closed = threading.Event()

    class Waiting(JumpingRobot):
        def connect(self):
            if not closed.wait(30):
                raise AssertionError("nobody ended the wait")
            raise devices.ConnectError("closed while connecting")

        def close(self):
            closed.set()

    class Unasked(Placer):
        def connect(self):
            raise devices.ConfigError("standard input is not a terminal")

    runner, _, _ = make(world, robot=Waiting(), positioner=Unasked())
    with pytest.raises(devices.ConfigError, match="not a terminal"):
        runner.run()
    assert closed.is_set()


def test_a_motion_at_the_reduced_speed_of_t1_arrives_in_time(world):
    """The scanner's path along straight joint motions, driven at 250 mm/s, takes less than the runner waits."""
    loaded = world[0]
    limits, arms = motion_limits(loaded), arms_beyond(loaded.cell)
    low, high = loaded.cell.robot.limits.T
    rng = np.random.default_rng(3)
    for start, target in zip(rng.uniform(low, high, (20, 6)), rng.uniform(low, high, (20, 6)), strict=True):
        T = loaded.cell.robot.chain.flange(start + np.linspace(0, 1, 400)[:, None] * (target - start)) @ loaded.cell.T_flange_scanner
        path_mm = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum()
        assert path_mm / 250.0 < longest_duration(target - start, limits, arms)


class Loaded(JumpingRobot):
    """An arm whose load somebody changes. loads: in kg, by the number of the pose; ``taken`` during its exposures."""

    def __init__(self, loads):
        super().__init__()
        self.loads, self.load, self.critical = loads, 2.3, True

    def facts(self):
        return (devices.Fact("load", self.load, "kg", 0.1, self.critical),)

    def move_to(self, q, limits):
        super().move_to(q, limits)
        self.load = self.loads.get(round(q[0] / 0.1) - 1, self.load)


class LoadingFinder(Finder):
    """The load changes while the exposures of a pose are looked at, and is set back before they end."""

    def __init__(self, robot, call):
        super().__init__()
        self.robot, self.call = robot, call

    def __call__(self, *args, **given):
        found = super().__call__(*args, **given)
        if self.calls == self.call:
            self.robot.load = 7.0
        return found


def test_a_pose_under_another_load_is_left_out_and_both_values_are_recorded(world):
    """Between poses 0 and 1 the load is set to 7 kg, between 1 and 2 back."""
    runner, seen, _ = make(world, robot=Loaded({1: 7.0, 2: 2.35}))
    runner.run()
    assert [e.pose for e in seen.of(events.PoseDone)] == [0, 2, 3]
    changes = [(e.role, e.name, e.before, e.now) for e in seen.of(events.FactChanged)]
    assert changes == [("robot", "load", "2.3 kg", "7 kg"), ("robot", "load", "7 kg", "2.35 kg")]
    assert ["pose 1 (s): the robot reported load 7 kg, but 2.3 kg when the run began, pose left out"] == [
        e.text for e in seen.of(events.Gap)
    ]
    assert [e.facts["robot load"] for e in seen.of(events.PoseDone)] == ["2.3 kg", "2.35 kg", "2.35 kg"]


def test_a_resumed_run_compares_with_what_was_recorded_before_and_the_report_shows_it(world, tmp_path):
    """The load is 2.3 kg now; the first part of the run had 7 kg."""
    runner, seen, _ = make(world, robot=Loaded({}), facts={"robot load": "7 kg"})
    with pytest.raises(devices.DeviceFault, match="the robot reported load 2.3 kg, but 7 kg when the run began"):
        runner.run()
    assert [(e.before, e.now) for e in seen.of(events.FactChanged)] == [("7 kg", "2.3 kg")]
    runner, seen, _ = make(world, robot=Loaded({}), facts={"robot load": "2.35 kg"})
    journal = Journal(tmp_path)
    runner.bus.subscribe(journal)
    runner.run()
    journal.close()
    assert recorded_facts(tmp_path) == {"robot load": "2.3 kg"}
    assert read_run_info(tmp_path)["identity"]["robot load, at the first pose"] == "2.3 kg"


def test_a_load_that_changes_during_the_exposures_spoils_that_pose(world):
    robot = Loaded({2: 2.3})
    runner, seen, _ = make(world, robot=robot, finder=LoadingFinder(robot, call=4))
    runner.run()
    assert [e.pose for e in seen.of(events.PoseDone)] == [0, 2, 3]


def test_a_load_that_stays_another_one_ends_the_run_with_both_values(world):
    runner, _, _ = make(world, robot=Loaded({1: 7.0}))
    with pytest.raises(devices.DeviceFault, match="the robot reported load 7 kg, but 2.3 kg when the run began"):
        runner.run()


def test_a_fact_that_is_not_critical_is_recorded_and_the_pose_is_kept(world):
    robot = Loaded({1: 7.0})
    robot.critical = False
    runner, seen, _ = make(world, robot=robot)
    runner.run()
    assert len(seen.of(events.PoseDone)) == 4
    assert [(e.before, e.now) for e in seen.of(events.FactChanged)] == [("2.3 kg", "7 kg")]
