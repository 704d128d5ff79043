"""Odds without exponents, and effects that have no name of their own."""

import pytest

from mbcacq.effects.in_words import effect_in_words, odds_in_words


@pytest.mark.parametrize(
    ("odds", "words"),
    [
        (1.0, "odds 1 : 1"),
        (0.4, "odds 1 : 2.5"),
        (1 / 651, "odds 1 : 650"),
        (3.64e-4, "odds less than 1 : 1000"),
        (1 / 3.64e8, "excluded"),
        (0.0, "excluded"),
        (4.0, "odds 4 : 1"),
        (1e9, "odds more than 1000 : 1"),
    ],
)
def test_odds_are_said_without_exponents(odds, words):
    assert odds_in_words(odds) == words


def test_what_no_effect_describes_is_called_unmodelled():
    assert effect_in_words("unknown:A1") == "unmodelled effect at A1"
    assert effect_in_words("unknown") == "unmodelled effect"
    assert effect_in_words("joint_compliance:A2") == "joint_compliance at A2"
