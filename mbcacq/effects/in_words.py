"""Odds, effects and the channels of a motion as a person reads them."""

from __future__ import annotations

from mbcacq.effects.effect_term import UNKNOWN

LEAST_ODDS = 1e-3  # what is less probable is not given a figure
EXCLUDED_ODDS = 1e-6  # what is less probable still is said to be excluded

CHANNELS = {
    "q_joint": "joint-side against motor-side angle",
    "q_set": "actual angle against set point",
    "tau": "torque against the rigid arm",
}


def odds_in_words(odds: float) -> str:
    """Posterior probability of one explanation relative to another, e.g. 'odds 1 : 40'; without an exponent."""
    if odds <= EXCLUDED_ODDS:
        return "excluded"
    if odds < LEAST_ODDS:
        return f"odds less than 1 : {1 / LEAST_ODDS:.0f}"
    if odds > 1 / LEAST_ODDS:
        return f"odds more than {1 / LEAST_ODDS:.0f} : 1"
    return f"odds 1 : {_plain(1 / odds)}" if odds <= 1 else f"odds {_plain(odds)} : 1"


def effect_in_words(name: str) -> str:
    """The name of an effect, 'unmodelled effect' for what no effect of the catalogue describes; 'NAME:A1' becomes 'NAME at A1'."""
    name, _, location = name.partition(":")
    words = "unmodelled effect" if name == UNKNOWN else name
    return f"{words} at {location}" if location else words


def spelt_out(name: str) -> str:
    """The same with spaces between its words, as pages and pictures have it."""
    return effect_in_words(name).replace("_", " ")


def _plain(value: float) -> str:
    """Two significant digits, without an exponent."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:.0f}" if rounded >= 10 else f"{rounded:g}"
