"""What the fake puts on the data channel, byte by byte."""

from __future__ import annotations

import socket
import struct

import numpy as np
import pytest
from gocator_bench import read_frame
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions, encode
from mbcacq_fakes.protocols.gocator.quantise import Scaling, quantise
from mbcacq_fakes.world.frame import ScannerFrame

SNAPSHOT = bytes.fromhex("06 00 00 00 28 45")


def shoot(sensor: FakeGocator) -> list[bytes]:
    """The data set of one snapshot."""
    with (
        socket.create_connection(("127.0.0.1", sensor.ports.data), timeout=5) as data,
        socket.create_connection(("127.0.0.1", sensor.ports.control), timeout=5) as control,
    ):
        control.sendall(SNAPSHOT)
        read_frame(control)
        messages = [read_frame(data)]
        while not messages[-1][5] & 0x80:
            messages.append(read_frame(data))
        return messages


def kinds(messages: list[bytes]) -> list[int]:
    return [struct.unpack_from("<H", m, 4)[0] & 0x7FFF for m in messages]


def test_point_cloud_of_four_points_is_the_annotated_frame():
    nan = np.nan
    xyz = np.array([[[-6, 0, 250], [nan, nan, nan]], [[-6, 1, 251.682], [-5, 1, 251.682]]], np.float32)
    message = encode.mark_last(encode.surface_points(xyz, Scaling((20000, 20000, 2000), (-5000, 1000, 250000)), 1500))
    annotated = bytearray.fromhex(
        "56 00 00 00 1c 80 36 00 02 00 00 00 02 00 00 00 20 4e 00 00 20 4e 00 00 d0 07 00 00 78 ec ff ff"
        "e8 03 00 00 90 d0 03 00 00 dc 05 00 00 00 06 00 00 00 00 00 00 00 01 00 00 00 00 00 00 00 ce ff"
        "ce ff 00 00 00 80 00 80 00 80 ce ff 00 00 49 03 00 00 00 00 49 03"
    )
    annotated[46] = 3  # stream step: surface, not tool output
    assert message.hex(" ") == annotated.hex(" ")


def test_measurement_and_health_are_the_annotated_frames():
    assert encode.mark_last(encode.measurement(4, float("nan"))).hex(" ") == (
        "20 00 00 00 1f 80 10 00 01 00 00 00 00 00 04 00 01 00 00 00 00 00 00 00 00 00 00 80 02 00 00 00"
    )
    assert encode.measurement(3, 12.345, generation=5).hex(" ") == "16 00 00 00 0a 00 01 00 00 00 00 00 03 00 39 30 00 00 01 00 00 00"
    assert encode.health({(20000, 0): 0, (2002, 1): 41}).hex(" ") == (
        "2e 00 00 00 00 80 02 00 00 00 00 00 00 00 20 4e 00 00 00 00 00 00 00 00 00 00 00 00 00 00 "
        "d2 07 00 00 01 00 00 00 29 00 00 00 00 00 00 00"
    )


def test_stamp_is_the_recorded_one_but_for_its_ptp_time(trace):
    recorded = next(line.data for line in trace if "type 1 size 78" in line.text)
    assert encode.stamp(0, 0x0A8BCC, 0, 12345)[:70] == recorded[:70]
    assert encode.stamp(0, 0x0A8BCC, 0, 12345, generation=5) == struct.pack("<I", 70) + recorded[4:10] + b"\x38" + recorded[11:70]


@pytest.mark.parametrize(("generation", "stamp_size", "surface_head"), [(6, 78, 62), (5, 70, 54)])
def test_order_and_sizes_of_a_data_set(frame, generation, stamp_size, surface_head):
    with FakeGocator(lambda e: frame, FakeGocatorOptions(generation=generation)) as sensor:
        messages = shoot(sensor)
    assert kinds(messages) == [1, 28, 9, 31 if generation == 6 else 10]
    assert len(messages[0]) == stamp_size
    assert len(messages[1]) == surface_head + 12 * 20 * 6
    assert len(messages[2]) == surface_head - 6 + 12 * 20
    assert [bool(m[5] & 0x80) for m in messages] == [False, False, False, True]


def test_uniform_spacing_of_the_job_turns_the_cloud_into_a_height_map(frame):
    with FakeGocator(lambda e: frame, FakeGocatorOptions(uniform=True, intensity=False)) as sensor:
        messages = shoot(sensor)
    assert kinds(messages) == [1, 8, 31]
    length, width, xr, yr, zr, xo, yo, zo = struct.unpack_from("<II3I3i", messages[1], 8)
    assert (length, width) == (12, 20)
    raw = np.frombuffer(messages[1], "<i2", offset=8 + 60).reshape(12, 20)
    assert (raw == -32768).sum() == 12
    column, row = np.meshgrid(np.arange(20), np.arange(12))
    x, y, z = xo / 1e3 + column * xr / 1e6, yo / 1e3 + row * yr / 1e6, zo / 1e3 + raw * (zr / 1e6)
    plane = 200 + 0.2 * (x + 4) - 0.1 * (y + 3)  # the frame's plane as a function of x and y in mm
    assert np.abs(z - plane)[raw != -32768].max() < 0.0011


def test_quantisation_is_half_a_step_and_nan_or_out_of_range_is_invalid():
    rng = np.random.default_rng(2)
    low, high = np.array([-77.0, -50, 164]), np.array([77.0, 50, 274])
    scaling = Scaling.over(low, high)
    assert scaling.resolution_nm == (3000, 3000, 2000)
    xyz = rng.uniform(low, high, (70, 200, 3)).astype(np.float32)
    xyz[3, 4, 1] = np.nan
    xyz[5, 6, 2] = 500
    raw = np.empty(xyz.shape, np.int16)
    quantise(xyz, scaling, raw)
    assert raw[3, 4].tolist() == raw[5, 6].tolist() == [-32768] * 3
    good = raw[..., 2] != -32768
    assert good.sum() == 70 * 200 - 2
    error = np.abs(raw * scaling.scale + scaling.offset - xyz)[good].max(axis=0)
    assert (error < np.array([1.5e-3, 1.5e-3, 1e-3]) + 2e-5).all()


def test_far_frames_get_coarser_steps_that_still_reach():
    scaling = Scaling.over(np.array([-1000.0, 0, 0]), np.array([1000.0, 1, 1]))
    assert scaling.resolution_nm == (30520, 3000, 2000)  # 1000 mm / 32766 steps, rounded up
    assert 32767 * scaling.scale[0] > 1000


def test_exposure_reaches_the_source_and_the_message(frame):
    asked = []

    def source(exposure_us: float) -> ScannerFrame:
        asked.append(exposure_us)
        return frame

    with FakeGocator(source) as sensor:
        sensor.files.set_number("Setup/Devices/Device[@role='0']/Exposure", 2500)
        messages = shoot(sensor)
    assert asked == [2500.0]
    assert struct.unpack_from("<I", messages[1], 41) == (2_500_000,)  # ns


def test_time_stamps_follow_the_worlds_clock(frame):
    moment = ScannerFrame(frame.xyz, frame.intensity, time_s=12.5)
    with FakeGocator(lambda e: moment, FakeGocatorOptions(clock=lambda: 12.25)) as sensor:
        stamp = shoot(sensor)[0]
    assert struct.unpack_from("<QQ", stamp, 14) == (0, 12_800_000)  # 12.5 s * 1.024 ticks a us


def test_all_clients_get_every_data_set(fake):
    with (
        socket.create_connection(("127.0.0.1", fake.ports.data), timeout=5) as one,
        socket.create_connection(("127.0.0.1", fake.ports.data), timeout=5) as two,
        socket.create_connection(("127.0.0.1", fake.ports.control), timeout=5) as control,
    ):
        for _ in range(200):
            if fake.state.data.count == 2:
                break
            fake.state.closing.wait(0.01)
        control.sendall(SNAPSHOT)
        assert read_frame(one) == read_frame(two)
