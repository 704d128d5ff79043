"""Mutated telegrams, messages and files end in a value or in one of our errors; a million of each are a matter of benchmarks/fuzz.py."""

from __future__ import annotations

import tracemalloc

import pytest
from fuzz_corpus import corpus
from fuzz_targets import targets
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mbcacq.errors import ConfigError
from mbcacq.spheres.ply import read_cloud

NAMES = sorted(targets())
CUTS = st.tuples(
    st.floats(0, 1),
    st.floats(0, 1),
    st.one_of(
        st.binary(max_size=12),
        st.sampled_from(
            [b"nan", b"1e999", b"-1", b"9" * 25, b"", b"[" * 100, b"\xff\xff\xff\xff", b"\0\0\0\x80", b"<!ENTITY x 'y'>", b"\0"]
        ),
    ),
)


def changed(seed: bytes, cuts: list[tuple[float, float, bytes]]) -> bytes:
    """A piece of the seed is replaced, several times."""
    for start, length, new in cuts:
        at = int(start * len(seed))
        seed = seed[:at] + new + seed[at + int(length**4 * len(seed)) :]
    return seed


@pytest.mark.parametrize("name", NAMES)
def test_valid_input_is_accepted(name):
    target = targets()[name]
    refused = [seed for seed in target.seeds if not target.run(seed)]
    assert len(refused) < len(target.seeds), refused[:1]


@pytest.mark.parametrize("name", NAMES)
def test_kept_inputs_are_accepted_or_refused(name, capfd):
    """Each takes a way through its parser that no other takes."""
    for data in corpus(name):
        targets()[name].run(data)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_changed_input_is_accepted_or_refused(name, data, capfd):
    target = targets()[name]
    target.run(changed(data.draw(st.sampled_from(target.seeds)), data.draw(st.lists(CUTS, max_size=4))))


@pytest.mark.parametrize("name", ["gocator reply", "gocator data set", "gocator message", "gocator health"])
@pytest.mark.parametrize("announced", [2**16, 2**24, 2**25, 2**29 - 1, 2**31, 2**32 - 1])
def test_an_announced_size_takes_no_memory_by_itself(name, announced):
    target = targets()[name]
    data = announced.to_bytes(4, "little") + target.seeds[0][4:]
    target.run(target.seeds[0])
    tracemalloc.start()
    assert not target.run(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * 2**20


HEAD = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"ply\nformat ascii 1.0\ncomment", "is no PLY file"),  # the library's reader ends the program here
        (b"", "is empty; save it anew"),
        (b"plyx\nend_header\n", "is no PLY file"),
        (HEAD.replace(b"2\n", b"2000000000\n") + b"0 0 0\n", "is cut off: its header announces at least 12000000000 bytes"),
        (HEAD.replace(b"property float z\n", b""), "holds no points"),
        (HEAD.replace(b"float y", b"float128 y"), "c.ply:5: 'property float128 y' is nothing"),
        (HEAD.replace(b"ascii", b"gzip"), "c.ply:2: 'format gzip 1.0' is nothing"),
        (HEAD.replace(b"element", b"comment " + b"x" * 600 + b"\nelement"), "c.ply:3: a header line of 608 bytes"),
    ],
)
def test_a_broken_cloud_is_refused_before_the_library_sees_it(tmp_path, data, words):
    (tmp_path / "c.ply").write_bytes(data)
    with pytest.raises(ConfigError, match=words):
        read_cloud(tmp_path / "c.ply")


@pytest.mark.parametrize("line", [b"comment VCGLIB generated\n", b"obj_info num_cols 100\n"])
def test_what_other_programs_write_into_headers_is_taken(tmp_path, line):
    data = HEAD.replace(b"element vertex", line + b"element vertex").replace(
        b"end_header", b"property uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header"
    )
    for end in (b"\n", b"\r\n"):
        (tmp_path / "c.ply").write_bytes(data.replace(b"\n", end) + b"0 1 2 255\n3 4 5.5 0\n3 0 1 0\n")
        assert read_cloud(tmp_path / "c.ply").tolist() == [[0, 1, 2], [3, 4, 5.5]]
