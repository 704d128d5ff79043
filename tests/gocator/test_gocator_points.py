"""Raw values become millimetres: mm = offset um / 1000 + raw * resolution nm / 1e6; by the compiled loop as with numpy."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from mbcacq_gocator import conversion
from mbcacq_gocator.decode import decode
from mbcacq_gocator.points import intensity_of, surface_points

from mbcacq.devices import ProtocolError

pytestmark = pytest.mark.usefixtures("way")

RESOLUTION, OFFSET = (2351, 3003, 1713), (-71003, 1000, 250001)


@pytest.fixture(params=["numpy", "compiled"])
def way(request, monkeypatch):
    loop = request.getfixturevalue("compiled_loop") if request.param == "compiled" else None
    monkeypatch.setattr(conversion, "compiled", lambda: loop)
    return request.param


def cloud(raw: np.ndarray) -> bytes:
    attributes = struct.pack("<II3I3iBIBiiii", *raw.shape[:2], *RESOLUTION, *OFFSET, 0, 1500, 0, 6, 0, 1, 0)
    body = struct.pack("<H", len(attributes)) + attributes + raw.astype("<i2").tobytes()
    return struct.pack("<IH", 6 + len(body), 28) + body


def height_map(raw: np.ndarray) -> bytes:
    attributes = struct.pack("<II3I3iBIi3siiii", *raw.shape, *RESOLUTION, *OFFSET, 0, 1500, 0, b"", 3, 0, 1, 0)
    body = struct.pack("<H", len(attributes)) + attributes + raw.astype("<i2").tobytes()
    return struct.pack("<IH", 6 + len(body), 8) + body


def unpacked(message):
    surface = surface_points(message)
    return surface.points, surface.pixel


def test_known_millimetres():
    frame = bytes.fromhex(
        "56 00 00 00 1c 80 36 00 02 00 00 00 02 00 00 00 20 4e 00 00 20 4e 00 00 d0 07 00 00 78 ec ff ff"
        "e8 03 00 00 90 d0 03 00 00 dc 05 00 00 00 06 00 00 00 00 00 00 00 01 00 00 00 00 00 00 00 ce ff"
        "ce ff 00 00 00 80 00 80 00 80 ce ff 00 00 49 03 00 00 00 00 49 03"
    )
    points, pixel = unpacked(decode(frame)[0])
    assert points.dtype == np.float32
    np.testing.assert_allclose(points, [[-6, 0, 250], [-6, 1, 251.682], [-5, 1, 251.682]], rtol=0, atol=2e-5)
    assert pixel.tolist() == [0, 2, 3]


def test_minus_one_is_a_height_and_minus_32768_is_none():
    raw = np.array([[[5, 5, -1], [5, 5, -32768], [-32768, -1, -32767]]])
    points, pixel = unpacked(decode(cloud(raw))[0])
    assert pixel.tolist() == [0, 2]
    np.testing.assert_allclose(points[:, 2], [250.001 - 0.001713, 250.001 - 32767 * 0.001713], rtol=0, atol=2e-5)


@pytest.mark.parametrize("kind", ["cloud", "uniform"])
def test_every_point_of_a_frame_within_0_3_m_is_exact_to_0_03_um(kind):
    rng = np.random.default_rng(5)
    raw = rng.integers(-32768, 32768, (257, 311, 3))  # more than one block, and a rest
    raw[rng.random((257, 311)) < 0.3, 2] = -32768
    scale, offset = np.array(RESOLUTION) / 1e6, np.array(OFFSET) / 1e3
    if kind == "cloud":
        points, pixel = unpacked(decode(cloud(raw))[0])
        exact = (raw * scale + offset).reshape(-1, 3)
    else:
        points, pixel = unpacked(decode(height_map(raw[..., 2]))[0])
        row, column = np.mgrid[:257, :311]
        exact = (np.stack([column, row, raw[..., 2]], axis=2) * scale + offset).reshape(-1, 3)
    assert pixel.tolist() == np.flatnonzero(raw[..., 2].ravel() != -32768).tolist()
    assert np.abs(points - exact[pixel]).max() < 3e-5


def test_all_valid_and_none_valid():
    raw = np.arange(4 * 5 * 3).reshape(4, 5, 3)
    assert len(surface_points(decode(cloud(raw))[0]).points) == 20
    points, pixel = unpacked(decode(cloud(np.full((4, 5, 3), -32768)))[0])
    assert points.shape == (0, 3)
    assert pixel.shape == (0,)
    assert surface_points(decode(height_map(np.full((4, 5), -32768)))[0]).points.shape == (0, 3)


def test_result_outlives_the_receive_buffer():
    received = bytearray(cloud(np.full((2, 2, 3), 100)))
    points = surface_points(decode(received)[0]).points
    before = points.copy()
    received[62:] = bytes(len(received) - 62)
    np.testing.assert_array_equal(points, before)


def test_a_scan_still_in_use_shares_no_memory_with_the_next():
    received = cloud(np.random.default_rng(1).integers(-32767, 32767, (30, 40, 3)))
    first, second = (surface_points(decode(received)[0]) for _ in range(2))
    assert not np.shares_memory(first.points, second.points)
    assert not np.shares_memory(first.pixel, second.pixel)
    kept = first.points.copy()
    second.points[:] = 0
    np.testing.assert_array_equal(first.points, kept)


def test_intensity_follows_the_pixels_and_must_fit_the_surface():
    attributes = struct.pack("<II2I2iBI3siiii", 2, 3, *RESOLUTION[:2], *OFFSET[:2], 0, 1500, b"", 6, 0, 1, 0)
    body = struct.pack("<H", 48) + attributes + bytes([1, 2, 3, 4, 5, 6])
    grey, _ = decode(struct.pack("<IH", 6 + len(body), 9) + body)
    raw = np.full((2, 3, 3), -32768)
    raw[0, 0] = raw[1, 2] = 7
    assert intensity_of(grey, surface_points(decode(cloud(raw))[0])).tolist() == [1, 6]
    with pytest.raises(ProtocolError, match="intensity"):
        intensity_of(grey, surface_points(decode(cloud(np.zeros((3, 3, 3))))[0]))


@pytest.mark.parametrize("make", [cloud, height_map], ids=["cloud", "uniform"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 100_000), (100_000, 1), (500, 301)])
def test_a_whole_frame_of_any_shape_is_converted_as_one_with_holes(make, shape):
    raw = np.random.default_rng(3).integers(-32767, 32768, (*shape, 3)[: 3 if make is cloud else 2])
    whole = surface_points(decode(make(raw))[0])
    assert whole.pixel.tolist() == list(range(shape[0] * shape[1]))
    raw[-1, -1] = -32768
    holed = surface_points(decode(make(raw))[0])
    np.testing.assert_array_equal(holed.pixel, whole.pixel[:-1])
    np.testing.assert_array_equal(holed.points, whole.points[:-1])


@pytest.mark.parametrize(
    ("make", "missing"), [(cloud, 0.0), (height_map, 0.0), (height_map, 0.3)], ids=["cloud", "uniform", "uniform with holes"]
)
def test_decoding_needs_hardly_more_memory_than_its_result(way, make, missing):
    rng = np.random.default_rng(4)
    raw = rng.integers(-32767, 32768, (1000, 1000, 3)[: 3 if make is cloud else 2])
    raw[rng.random((1000, 1000)) < missing] = -32768
    message = make(raw)
    tracemalloc.start()
    try:
        surface = surface_points(decode(message)[0])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    most = 1.3 if way == "compiled" else 2.0  # numpy makes what it selects by as arrays of their own
    assert peak < most * sum(array.nbytes for array in (surface.points, surface.pixel))
