"""Whatever bytes come, decoding ends in a message or a ProtocolError, and takes no memory that the bytes did not fill."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mbcacq_gocator import layouts
from mbcacq_gocator.configuration import Configuration
from mbcacq_gocator.decode import ArrayMessage, decode
from mbcacq_gocator.discovery import parse_reply
from mbcacq_gocator.information import parse_info_1, parse_info_2, parse_states
from mbcacq_gocator.points import surface_points

from mbcacq.devices import MbcacqError, ProtocolError

KINDS = st.sampled_from(sorted(layouts.ARRAYS) + [0, 1, 10, 31, 36, 500])
SMALL = st.integers(0, 6)
SIZES = st.one_of(SMALL, st.sampled_from([0, 2**16, 2**31 - 1, 2**31, 2**32 - 1]))


def within_memory(action, data: bytes, factor: int) -> None:
    tracemalloc.start()
    try:
        action()
    finally:
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak < 65536 + factor * len(data)


def read(message: bytes) -> None:
    try:
        decoded, _ = decode(message)
        if isinstance(decoded, ArrayMessage):
            surface = surface_points(decoded)
            assert len(surface.points) == len(surface.pixel) <= surface.shape[0] * surface.shape[1]
    except ProtocolError:
        pass


@given(kind=KINDS, last=st.booleans(), body=st.binary(max_size=400))
@settings(max_examples=400, deadline=None)
def test_any_body(kind, last, body):
    message = struct.pack("<IH", 6 + len(body), kind | (0x8000 if last else 0)) + body
    within_memory(lambda: read(message), message, 50)


@given(
    kind=st.sampled_from(sorted(layouts.ARRAYS)), attribute_size=st.integers(0, 90), length=SIZES, width=SIZES, rest=st.binary(max_size=300)
)
@settings(max_examples=400, deadline=None)
def test_any_announced_size(kind, attribute_size, length, width, rest):
    body = struct.pack("<HII", attribute_size, length, width) + rest
    message = struct.pack("<IH", 6 + len(body), kind) + body
    within_memory(lambda: read(message), message, 50)


@pytest.mark.parametrize("kind", [layouts.UNIFORM_SURFACE, layouts.SURFACE_POINTS])
@pytest.mark.parametrize("shape", [(0, 2**26), (2**26, 0), (0, 2**32 - 1)])
def test_a_surface_without_points_takes_no_memory(kind, shape):
    attributes = struct.pack("<II3I3iBIBii", *shape, 1000, 1000, 1000, 0, 0, 0, 0, 0, 0, 6, 0)
    body = struct.pack("<H", len(attributes)) + attributes
    message = struct.pack("<IH", 6 + len(body), kind) + body
    within_memory(lambda: read(message), message, 50)
    assert len(surface_points(decode(message)[0]).points) == 0


@given(data=st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_any_bytes_as_a_whole_message(data):
    read(data)


@given(data=st.binary(max_size=300), parse=st.sampled_from([parse_info_1, parse_info_2, parse_states, parse_reply, Configuration]))
@settings(max_examples=300, deadline=None)
def test_any_reply_payload(data, parse):
    try:
        parse(memoryview(data) if parse is not Configuration else data)
    except MbcacqError:
        pass


@given(length=st.integers(1, 5), width=st.integers(1, 7), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_valid_points_are_exactly_those_with_a_height(length, width, seed):
    raw = np.random.default_rng(seed).choice(np.array([-32768, -1, 0, 32767], "<i2"), (length, width, 3))
    attributes = struct.pack("<II3I3iBIBii", length, width, 1000, 1000, 1000, 0, 0, 0, 0, 0, 0, 6, 0)
    body = struct.pack("<H", len(attributes)) + attributes + raw.tobytes()
    surface = surface_points(decode(struct.pack("<IH", 6 + len(body), 28) + body)[0])
    assert surface.pixel.tolist() == [i for i, z in enumerate(raw[..., 2].ravel().tolist()) if z != -32768]
    np.testing.assert_allclose(surface.points, raw.reshape(-1, 3)[surface.pixel] / 1000, rtol=0, atol=4e-6)
