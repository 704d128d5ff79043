"""Devices that go away and come back, and an arm that is stopped while the run waits for something else."""

import time
from dataclasses import replace

import numpy as np
import pytest
from stand_ins import JumpingRobot, Placer, StandIn, StillScanner
from test_runner import Finder, make, world  # noqa: F401 world is a fixture

from mbcacq import devices
from mbcacq.acquisition import events, reconnect_policy
from mbcacq.devices import Description, Field
from mbcacq.plan.schema import SensorUse


@pytest.fixture(autouse=True)
def brisk(monkeypatch):
    monkeypatch.setattr(reconnect_policy, "PAUSE_S", 0.01)


class Rebooting(StillScanner):
    """Gone from its third exposure on, for ``down`` attempts to connect."""

    def __init__(self, down, serials=("7", "7")):
        super().__init__()
        self.down, self.exposures, self._serials, self._booted = down, 0, serials, False

    def describe(self):
        return Description("scanner", "stand-in", (), serial=self._serials[self._booted])

    def connect(self):
        super().connect()
        if self.exposures >= 3 and self.down > 0:
            self.down -= 1
            self._booted = True
            raise devices.ConnectError("nothing answers at 192.168.1.10")

    def capture(self, exposure_us=None):
        self.exposures += 1
        if self.exposures == 3:
            raise devices.ConnectError("the scanner closed the connection")
        return super().capture(exposure_us)


def with_plan(world, **changes):  # noqa: F811
    loaded, poses = world
    return replace(loaded, plan=loaded.plan.model_copy(update=changes)), poses


def test_a_scanner_that_restarts_costs_no_pose_and_is_reported(world):  # noqa: F811
    runner, seen, _ = make(world, scanner=Rebooting(down=3))
    runner.run()
    assert [e.pose for e in seen.of(events.PoseDone)] == [0, 1, 2, 3]
    assert [e.n_exposures for e in seen.of(events.PoseDone)] == [3, 3, 3, 3]
    words = [e.text for e in seen.of(events.Message) if e.level == "warning"]
    assert "closed the connection; trying again" in words[0]
    assert "back after" in words[1]
    assert "lost 1 times" in seen.events[-1].reason


def test_a_scanner_that_stays_away_ends_the_run(world):  # noqa: F811
    loaded, _ = world
    scanner = loaded.plan.scanner.model_copy(update={"reconnect_s": 0.05})
    runner, seen, parts = make(with_plan(world, scanner=scanner), scanner=Rebooting(down=10**6))
    with pytest.raises(devices.ConnectError, match=r"nothing answers at 192\.168\.1\.10"):
        runner.run()
    assert seen.events[-1].exit_status == "fail"
    assert parts["robot"].log[-1] == "close"


def test_another_scanner_in_its_place_is_refused(world):  # noqa: F811
    runner, _, _ = make(world, scanner=Rebooting(down=1, serials=("7", "8")))
    with pytest.raises(devices.IdentityError, match="came back as serial number 8, it was 7"):
        runner.run()


def test_an_exposure_that_is_refused_is_not_tried_again(world):  # noqa: F811
    scanner = StillScanner()
    scanner.fault = devices.DeviceFault("the sensor refused the exposure: its laser is locked")
    runner, seen, _ = make(world, scanner=scanner)
    with pytest.raises(devices.DeviceFault, match="laser is locked"):
        runner.run()
    assert len(seen.of(events.PoseReached)) == 1


@pytest.mark.parametrize("where", ["positioner", "scanner"])
def test_an_arm_that_is_stopped_meanwhile_ends_the_wait(world, where):  # noqa: F811
    """The operator places the artefact, the scanner starts again: the arm's fault is not noticed only minutes later."""
    robot = JumpingRobot()

    class Slow(Placer):
        stopped = False

        def go_to(self, station, prompt):
            robot.fault = devices.SafetyStop("protective stop: the safety gate was opened")
            deadline = time.monotonic() + 600.0
            while not self.stopped and time.monotonic() < deadline:
                time.sleep(0.01)
            raise devices.Aborted("stopped")

        def stop(self):
            self.stopped = True

    class Gone(Rebooting):
        def connect(self):
            if self.exposures >= 3:
                robot.fault = devices.SafetyStop("protective stop: the safety gate was opened")
            super().connect()

    change = {"positioner": Slow()} if where == "positioner" else {"scanner": Gone(down=10**6)}
    runner, seen, _ = make(world, robot=robot, **change)
    with pytest.raises(devices.SafetyStop, match="safety gate"):
        runner.run()
    assert "safety gate" in seen.events[-1].reason


class Sagging(JumpingRobot):
    """Sinks while the scanner exposes, ``times`` times."""

    def __init__(self, times):
        super().__init__()
        self.left = times

    def sink(self):
        if self.left > 0:
            self.left -= 1
            self.state()
            self.q = self.q + np.radians([0, 0.1, 0, 0, 0, 0])


@pytest.mark.parametrize(("times", "ends"), [(1, False), (10**6, True)])
def test_an_arm_that_moves_during_the_exposures_spoils_no_pose(world, times, ends):  # noqa: F811
    robot = Sagging(times)

    class Exposing(StillScanner):
        def capture(self, exposure_us=None):
            robot.sink()
            return super().capture(exposure_us)

    runner, seen, _ = make(world, robot=robot, scanner=Exposing())
    if ends:
        with pytest.raises(devices.SafetyStop, match=r"moved by 0\.\d+° during the exposures of pose 0, twice"):
            runner.run()
        return
    runner.run()
    loaded, poses = world
    for done, pose in zip(seen.of(events.PoseDone), poses, strict=True):
        np.testing.assert_allclose(done.q, pose.q, atol=1e-12)


class Probe(StandIn):
    def __init__(self, fails):
        super().__init__()
        self.reads, self.fails = 0, fails

    def describe(self):
        return Description("sensor", "probe", (Field("air_C", "C"),))

    def read(self):
        self.reads += 1
        if self.reads in self.fails:
            raise devices.DeviceTimeout("the probe is silent")
        return {"air_C": 20.0 + self.reads}


def run_with_probe(world, fails, required=False):  # noqa: F811
    probe = Probe(fails)
    plan = with_plan(world, sensors=(SensorUse(driver="x", required=required),))
    runner, seen, _ = make(plan)
    runner.devices = replace(runner.devices, sensors=(probe,))
    return runner, seen, probe


def test_a_probe_is_read_again_on_a_new_connection(world):  # noqa: F811
    runner, seen, probe = run_with_probe(world, fails={2})
    runner.run()
    assert [e.sensors for e in seen.of(events.PoseDone)] == [{"air_C": 21.0}, {"air_C": 23.0}, {"air_C": 24.0}, {"air_C": 25.0}]
    assert not seen.of(events.Gap)


def test_a_missing_temperature_is_a_gap_by_name_not_silence(world):  # noqa: F811
    runner, seen, _ = run_with_probe(world, fails={2, 3})
    runner.run()
    assert [e.sensors for e in seen.of(events.PoseDone)] == [{"air_C": 21.0}, {}, {"air_C": 24.0}, {"air_C": 25.0}]
    (gap,) = seen.of(events.Gap)
    assert (gap.kind, gap.pose) == ("sensor", 1)
    assert "probe is silent; pose 1 has no air_C" in gap.text


def test_a_required_temperature_ends_the_run(world):  # noqa: F811
    runner, _, _ = run_with_probe(world, fails={2, 3}, required=True)
    with pytest.raises(devices.DeviceTimeout, match="probe is silent"):
        runner.run()


def test_a_pose_left_out_is_a_gap(world):  # noqa: F811
    class BlindOnce(Finder):
        def __call__(self, *args, **kwargs):
            self.seen = 1 if 3 <= self.calls < 6 else None
            return super().__call__(*args, **kwargs)

    runner, seen, _ = make(world, finder=BlindOnce())
    runner.run()
    (gap,) = seen.of(events.Gap)
    assert (gap.kind, gap.pose) == ("pose", 1)


def test_cycles_the_network_lost_are_counted(world):  # noqa: F811
    class Lossy(JumpingRobot):
        def state(self):
            state = super().state()
            if len(self.rows) and abs(self.rows[-1][0] % 20.0) < 0.1:
                self.rows.pop()
                self.lost = getattr(self, "lost", 0) + 1
            return state

    robot = Lossy()
    runner, seen, _ = make(world, robot=robot)
    robot.time = 15.0
    for _ in range(30):
        robot.state()
    runner.run()
    assert robot.lost >= 1
    assert any(e.kind == "cycles" and e.text.startswith(f"{robot.lost} robot cycles") for e in seen.of(events.Gap))
