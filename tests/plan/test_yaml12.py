"""Numbers are those of YAML 1.2 (its core schema), with the underscore that people write between digits."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from mbcacq.model import yaml12


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e9", 1e9),
        ("1_000", 1000),
        ("5.", 5.0),
        (".5", 0.5),
        ("+12", 12),
        ("-1.5E-3", -1.5e-3),
        ("1e+3", 1000.0),
        ("010", 10),  # YAML 1.1 takes this for eight
        ("0o10", 8),
        ("0x1F", 31),
        ("1_000.5", 1000.5),
        ("12:30", "12:30"),  # and this for 750
        ("1__0", "1__0"),
        ("_1", "_1"),
        ("1e", "1e"),
        ("e9", "e9"),
        ("0b11", "0b11"),
        (".", "."),
        ("-", None),  # a list with one empty entry
    ],
)
def test_numbers(text, value):
    found = yaml12.load(f"a: {text}" if text != "-" else "a:")["a"]
    assert found == value
    assert type(found) is type(value)


@given(st.from_regex(r"\A[-+0-9._eExo:a-f]{1,8}\Z"))
def test_a_text_that_looks_like_a_number_comes_back_as_the_text(text):
    assert yaml12.load(yaml12.dump({"id": text}))["id"] == text


@given(st.floats(allow_nan=False))
def test_a_number_comes_back_bit_for_bit(value):
    assert yaml12.load(yaml12.dump([value])) == [value]


def test_only_plain_data_are_constructed():
    import yaml

    with pytest.raises(yaml.YAMLError):
        yaml12.load("!!python/object/apply:os.system ['true']")
