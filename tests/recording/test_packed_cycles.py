"""Packed controller cycles come back bit for bit, whatever their values are, and damage to one batch costs that batch alone."""

import json
import zlib
from contextlib import suppress

import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mbcacq.recording.rrd import layout, rows
from mbcacq.recording.rrd.new_stream import new_stream
from mbcacq.recording.rrd.packed_cycles import packed, unpacked
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.run_folder.check import check

SHAPE = st.tuples(st.integers(1, 30), st.integers(0, 7))
ANY = st.sampled_from([np.float64, np.float32, np.int64, np.uint64, np.int16, np.uint8, np.bool_]).flatmap(lambda t: hnp.arrays(t, SHAPE))
DECIMALS = st.builds(
    lambda whole, decimals, unit: whole / 10.0**decimals * unit,
    hnp.arrays(np.int64, SHAPE, elements=st.integers(-(10**9), 10**9)),
    st.integers(0, 12),
    st.sampled_from([1.0, np.pi / 180]),
)


def assert_same_bits(back, values):
    assert back.dtype == values.dtype
    assert back.shape == (len(values), values[0].size)
    assert back.tobytes() == values.tobytes()


@given(ANY | DECIMALS)
def test_every_bit_comes_back(values):
    assert_same_bits(unpacked(packed({"a": values, "b": values[::-1]}))["a"], values)
    assert_same_bits(unpacked(packed({"a": values, "b": values[::-1]}), ("b",))["b"], np.ascontiguousarray(values[::-1]))


@pytest.mark.parametrize("value", [-0.0, np.nan, -np.inf, 5e-324, 1.7976931348623157e308, 0.1 + 0.2, 2.0**53 + 2, 1e-9])
def test_so_do_values_that_no_decimal_is(value):
    for others in (0.0, 1.5, 1e300):
        values = np.array([others, value, others])
        assert_same_bits(unpacked(packed({"q": values}))["q"], values)
    payload = np.array([0x7FF8000000000123], np.uint64).view(np.float64)  # a NaN that says something
    assert_same_bits(unpacked(packed({"q": payload}))["q"], payload)


def test_the_bytes_of_two_cycles_are_these():
    """1.5 s and 1.504 s are 1500 and 1504 thousandths: first difference 1500, folded 3000 = 0x0bb8, then 4, folded 8."""
    head, body = zlib.decompress(packed({"time_s": np.array([1.5, 1.504])}).tobytes()).split(b"\n", 1)
    assert json.loads(head) == {"rows": 2, "columns": [["time_s", 1, "<f8"]], "code": [1]}
    assert body == bytes([0xB8, 0x08, 0x0B, 0, *12 * [0], 0, 0])


def test_what_never_changes_and_millionths_of_a_degree_take_few_bytes():
    rng = np.random.default_rng(3)
    q = np.radians(np.round(30 + np.cumsum(rng.normal(0, 0.01, (200, 6)), axis=0), 6))
    constant = {f"c{i}": np.full((200, 6), 37.123456) for i in range(10)}
    assert len(packed({"q": q})) < 200 * 6 * 3
    assert len(packed({"q": q, **constant})) - len(packed({"q": q})) < 0.01 * (200 * 60 * 8)


def test_texts_are_refused():
    with pytest.raises(TypeError, match="cannot be recorded"):
        packed({"a": np.array(["x"])})


@given(st.integers(0, 10_000), st.integers(0, 7))
def test_a_flipped_bit_is_noticed_or_changes_nothing(where, bit):
    values = np.linspace(0, 1, 60).reshape(10, 6)
    data = packed({"q": values}).copy()
    data[where % len(data)] ^= 1 << bit
    with suppress(ValueError):
        assert_same_bits(unpacked(data)["q"], values)  # a bit that fills up the last byte before the checksum


def test_bytes_of_something_else_are_no_cycles():
    for text in (
        b"",
        b"\n",
        b"{}\n",
        b'{"rows":9,"columns":[["a",1,"<f8"]],"code":[1]}\nshort',
        b"[1]\n",
        b'{"rows":1,"columns":[["a"]],"code":[0]}\n' + bytes(9),
    ):
        with pytest.raises(ValueError, match="damaged"):
            unpacked(np.frombuffer(zlib.compress(text), np.uint8))


def test_batches_around_a_damaged_one_and_cycles_of_an_earlier_version_are_read(tmp_path):
    """Whatever wrote them, the batches come back in order; the damaged one is missing, and the check says so."""
    stream = new_stream(layout.APPLICATION, recording_id="r")
    stream.set_sinks(rr.FileSink(tmp_path / "run.rrd"))
    batches = [{"time_s": np.arange(k, k + 3.0), "q": np.full((3, 6), k / 7)} for k in (0, 3, 6, 9)]
    at = [rr.TimeColumn(layout.TIME, duration=np.array([0.0, 1.0, 2.0]))]
    stream.send_columns(layout.CYCLES, at, rows.columns(layout.CYCLES_ARCHETYPE, batches[0]))  # one row a cycle, as before
    for batch in batches[1:]:
        data = packed(batch).copy()
        data[20] ^= 4 * (batch is batches[2])
        one = [rr.TimeColumn(layout.TIME, duration=np.array([2.0]))]
        stream.send_columns(layout.CYCLES, one, rows.columns(layout.CYCLES_ARCHETYPE, {layout.PACKED: data[None]}))
    stream.flush()
    stream.disconnect()
    recording = Recording(tmp_path / "run.rrd")
    np.testing.assert_array_equal(recording.cycles().columns["time_s"], [0, 1, 2, 3, 4, 5, 9, 10, 11])
    np.testing.assert_array_equal(recording.cycles(("q",)).columns["q"][:, 5], np.repeat([0, 3 / 7, 9 / 7], 3))
    assert recording.damaged_cycles() == 1
    assert any(
        "batches of controller cycles that are not as they were written: 1" in fault
        for file in check(tmp_path / "run.rrd")
        for fault in file.faults
    )
