"""The bytes of a session are written down and played back to the same driver, which then sees the same device."""

from __future__ import annotations

import re
import socket

import numpy as np
import pytest
from bench_bus import modbus_sensor
from bench_gocator import gocator
from bench_gopxl import gopxl
from bench_kuka import HOME_DEG, LIMITS_DEG, kuka_rsi
from mbcacq_bus.modbus import ModbusSensor
from mbcacq_fakes.cell.ports import free_port
from mbcacq_gocator.driver import Gocator
from mbcacq_gocator.gopxl.driver import GoPxL
from mbcacq_kuka.rsi.driver import KukaRsi

from mbcacq.conformance import Replay, Trace
from mbcacq.conformance.bounded import eventually
from mbcacq.conformance.trace import TraceLine

IPOC = re.compile(rb"<IPOC>\d+</IPOC>")


@pytest.fixture
def saved(tmp_path):
    """A trace goes through its file."""

    def through(trace: Trace) -> Trace:
        trace.save(tmp_path / "session.txt")
        return Trace.load(tmp_path / "session.txt")

    return through


def without(trace: Trace, link: str) -> Trace:
    return Trace([line for line in trace.lines if line.link != link])


def lock_step(lines: list[TraceLine]) -> list[TraceLine]:
    """Each telegram beside its answer: how far a busy computer lets the two run apart is nothing to be repeated.

    The first telegrams found nobody, and have no answer.
    """
    asked = {IPOC.search(line.data)[0]: line for line in lines if line.sender == "device"}
    answers = [line for line in lines if line.sender == "driver"]
    return [line for answer in answers for line in (asked[IPOC.search(answer.data)[0]], answer)]


def test_a_gocator_session_gives_the_same_scan_again(saved):
    trace, scans = Trace(), []
    with gocator(trace) as stand, stand.make(timeout_s=10.0, reply_limit_s=5.0) as scanner:
        scans.append(scanner.capture(900.0))
    with Replay(without(saved(trace), "health")) as replay, socket.create_server(("127.0.0.1", 0)) as health:
        ports = {"control_port": replay.ports["control"], "data_port": replay.ports["data"], "health_port": health.getsockname()[1]}
        with Gocator("front", "3210", {"address": "127.0.0.1", **ports}) as scanner:
            assert scanner.describe().serial == "12345"
            scans.append(scanner.capture(900.0))
    assert replay.differences == []
    for name in ("points", "pixel", "intensity"):
        np.testing.assert_array_equal(getattr(scans[0], name), getattr(scans[1], name))
    assert (scans[0].frame, scans[0].time_s) == (scans[1].frame, scans[1].time_s)


def test_a_gopxl_session_gives_the_same_scan_again(saved):
    """What stands in for a sensor is every byte that came from one; what the driver sends is compared with what was sent then."""
    trace, scans = Trace(), []
    with gopxl(trace) as stand, stand.make(timeout_s=10.0) as scanner:
        scans.append(scanner.capture(900.0))
    with Replay(saved(trace)) as replay:
        ports = {"control_port": replay.ports["control"], "data_port": replay.ports["data"]}
        with GoPxL("scanner", "3504", {"address": "127.0.0.1", "timeout_s": 10.0, **ports}) as scanner:
            scans.append(scanner.capture(900.0))
    assert replay.differences == []
    for name in ("points", "pixel", "intensity"):
        np.testing.assert_array_equal(getattr(scans[0], name), getattr(scans[1], name))
    assert len(scans[0].points) == 228


def test_a_modbus_session_gives_the_same_reading_again(saved):
    trace = Trace()
    with modbus_sensor(trace) as stand, stand.make(timeout_s=5.0) as sensor:
        reading = sensor.read()
        options = sensor._options.model_dump()
    with Replay(saved(trace)) as replay, ModbusSensor("lift", "L4", {**options, "port": replay.ports["modbus"]}) as sensor:
        assert sensor.read() == reading
        eventually(lambda: replay.finished, 5.0, "the whole session is played")
    assert replay.differences == []


def test_the_beginning_of_an_rsi_session_is_answered_byte_for_byte_the_same(saved):
    trace = Trace()
    exact = {"encoder_noise_deg": 0.0, "encoder_step_deg": 0.0}
    with kuka_rsi(trace, **exact) as stand, stand.make(stop_at_close=False) as robot:
        robot.state()
    lines = lock_step(saved(trace).lines)
    port = free_port()
    robot = KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port, "stop_at_close": False})
    with Replay(Trace(lines[:140]), {"rsi": ("127.0.0.1", port)}) as replay:
        with robot:
            np.testing.assert_allclose(np.degrees(robot.state().q), HOME_DEG, atol=1e-9)
        assert replay.played >= 12
    assert replay.differences == []


def test_a_file_that_is_no_trace_is_refused(tmp_path):
    (tmp_path / "other.txt").write_text("rsi somebody 00\n")
    with pytest.raises(ValueError, match="neither device nor driver"):
        Trace.load(tmp_path / "other.txt")
