"""EKI: where telegrams end."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mbcacq_kuka.eki.framing import MAX_TELEGRAM, Cutter, FramingError

STATUS = b'<Robot><Status ControlMode="1" CycleTime="1" DrivesPowered="0"></Status></Robot>'
EVENT = b'<Robot><Response EventID="3"> </Response></Robot >'
EMPTY = b'<Robot A="1" />'


@given(
    st.lists(st.sampled_from([STATUS, EVENT, EMPTY]), max_size=5),
    st.sampled_from([b"", b"\n", b"\n\0\0\0", b"x > y", b"</Robot>", b"<Rob"]),
    st.integers(1, 200),
)
def test_telegrams_are_the_same_however_the_stream_is_cut(telegrams, junk, size):
    stream = junk + b"".join(t + junk for t in telegrams)
    cutter = Cutter("Robot")
    found = [t for i in range(0, len(stream), size) for t in cutter.feed(stream[i : i + size])]
    assert found == telegrams


def test_a_name_that_only_begins_like_the_root_is_junk():
    assert Cutter("Robot").feed(b"<RobotState a='1'></RobotState>" + EVENT) == [EVENT]


def test_endless_telegrams_and_declarations_are_refused():
    cutter = Cutter("Robot")
    assert cutter.feed(b"<Robot>" + b" " * (MAX_TELEGRAM - 7)) == []
    with pytest.raises(FramingError, match="longer"):
        cutter.feed(b" and no end")
    with pytest.raises(FramingError, match="declaration"):
        Cutter("Robot").feed(b"<Robot><!DOCTYPE x></Robot>")
