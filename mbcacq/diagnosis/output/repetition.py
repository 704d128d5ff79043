"""What an effect leaves open, in sentences that text and page share: its orders, and whether parts of the recording show it again."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from mbcacq.diagnosis.effect_found import EffectFound, PossibleOrder
from mbcacq.effects.in_words import odds_in_words
from mbcacq.quantities import K, measured


def sentences(effect: EffectFound) -> list[str]:
    """All of them; those of a trend without its orders, which are no figures then."""
    orders = [] if effect.trend else order_sentences(effect)
    return [*orders, *repetition_sentences(effect), *effect.notes]


def order_sentences(effect: EffectFound) -> list[str]:
    """One for each line with several possible orders, and one for each joint with lines whose order is not determined."""
    out = []
    for at, mine in groupby(effect.orders, key=lambda one: one.at):
        lines = [list(line) for _, line in groupby(mine, key=lambda one: one.line)]
        out += [_several(at, line) for line in lines if line[0].determined and len(line) > 1]
        unknown = [line for line in lines if not line[0].determined]
        if unknown:
            every = [one.order for line in unknown for one in line]
            low, high = f"{min(every):.3g}", f"{max(every):.3g}"
            where = f"about {low}" if low == high else f"between {low} and {high}"
            which = "the order" if len(lines) == 1 else f"the order of {len(unknown)} of {len(lines)} lines"
            out.append(f"{at}: {which} is not determined ({where}); within the angles of the recording it is a smooth function of these")
    return out


def _several(at: str, line: Sequence[PossibleOrder]) -> str:
    first, *others = line
    more = " or ".join(f"{measured(one.order, K * one.sigma)} ({odds_in_words(one.odds)})" for one in others)
    return f"{at}: a line of order {measured(first.order, K * first.sigma)} or {more}"


def repetition_sentences(effect: EffectFound) -> list[str]:
    """In how many parts it was found again: one sentence for all of its locations that have the same answer."""
    out = []
    kinds = sorted({(one.found_in, one.parts, one.disjoint) for one in effect.found_again}, reverse=True)
    for found_in, parts, disjoint in kinds:
        same = [one for one in effect.found_again if (one.found_in, one.parts, one.disjoint) == (found_in, parts, disjoint)]
        at = f"{', '.join(one.at for one in same)}: " if len(effect.found_again) > 1 else ""
        what = f"{parts} halves by blocks" if disjoint else f"{parts} searches without a part of the poses (too few poses for halves)"
        out.append(f"{at}found again in {found_in} of {what}")
    return out


def in_short(effect: EffectFound) -> str:
    """How many halves show it at all of its locations; empty if halves were not searched."""
    halves = [one for one in effect.found_again if one.disjoint]
    return f"found again in {min(one.found_in for one in halves)} of {halves[0].parts} halves" if halves else ""
