"""A diagnosis on one screen: what was found, each in a line, and what qualifies it. ``words`` says all."""

from __future__ import annotations

import re
from collections.abc import Sequence

from mbcacq.diagnosis.effect_found import LINE, EffectFound, MismatchEntry
from mbcacq.diagnosis.output import repetition, text
from mbcacq.diagnosis.output.figures import beyond_uncertainty
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.effects.in_words import CHANNELS, effect_in_words
from mbcacq.quantities import p_value, percent, split_unit

MOST_LINES = 14  # of all effects
MOST_FIGURES = 4  # of one effect and location
MOST_NOTES = 4
MOST_SHARES = 5
WHOLE = "All figures, limits and notes: --all."
_NOT_CONSIDERED = re.compile(r"^(\w+) was not considered: ")


def brief(d: Diagnosis, calibrated: bool = False) -> str:
    """The verdict in its five lines, the effects, and at most ten lines of detail. calibrated: as ``text.words``."""
    floor = text.noise_floor(d)
    lines = [text.first_sentence(d, floor), *text.summary_lines(d, floor, calibrated), ""]
    lines += effects_in_brief(d.effects, floor.is_excess(d.fit.held_out.before_chi2_dof))
    lines += mismatch_in_brief(d.mismatch)
    lines += text.geometry_lines(d.geometry_alone)[:2]
    lines += text.proposal_lines(d.proposals)[:2]
    lines += limits_in_brief(d)
    lines += [text.difference(one) for one in d.between_recordings if one.differs][:2]
    return "\n".join([*lines, *notes_in_brief(d.notes), WHOLE])


def effects_in_brief(effects: Sequence[EffectFound], excess: bool = True) -> list[str]:
    """Findings and trends, a line each, or one for each of their locations; what does not fit is counted."""
    out = list[str]()
    for heading, some in zip((text.FINDINGS, text.TRENDS), text.findings_and_trends(effects), strict=True):
        each = [effect_in_brief(e, excess) for e in some]
        room, shown = MOST_LINES - len(out), 0
        out += [heading] if each else []
        for lines in each:
            if shown and len(lines) > room:
                break
            out, room, shown = [*out, *lines], room - len(lines), shown + 1
        out += [f"  and {len(each) - shown} more"] if shown < len(each) else []
    return [*out, ""] if out else []


def effect_in_brief(effect: EffectFound, excess: bool) -> list[str]:
    """One effect with its largest figures; those of several locations in a line each."""
    share = f", removes {percent(effect.gain_here)} of the excess over noise" if excess and not effect.trend else ""
    again = f", {shown}" if (shown := repetition.in_short(effect)) else ""
    head = f"  {effect_in_words(effect.name)} at {', '.join(effect.where)} ({p_value(effect.p_value)}{share}{again})"
    if effect.trend:
        return [f"{head}: {effect.trend}"]
    if effect.shape is not None:
        return [f"{head}: {text.size_of_shape(effect, effect.shape)}"]
    by_location: dict[str, dict[str, ParameterEstimate]] = {}
    for name, estimate in beyond_uncertainty(effect.parameters)[0].items():
        location, _, quantity = name.rpartition(".")
        by_location.setdefault(location, {})[quantity] = estimate
    said = {at: figures_of(own) for at, own in by_location.items()}
    if len(said) > 1 and all(len(each) == 1 for each in said.values()):  # one figure each, as the parts of an unmodelled effect
        ranked = [f"{at.replace('_', ' ')} {each[0]}" for at, each in said.items()]
        return [f"{head}: {in_short(ranked)}"]
    if len(said) <= 1:
        several = len(effect.where) > 1
        return [f"{head}: {f'{at} ' if at and several else ''}{in_short(each)}" for at, each in said.items()] or [head]
    return [head, *(f"    {at}: {in_short(each)}" for at, each in said.items())]


def in_short(figures: Sequence[str]) -> str:
    """The first figures, and how many more there are."""
    more = f" and {len(figures) - MOST_FIGURES} more" if len(figures) > MOST_FIGURES else ""
    return "; ".join(figures[:MOST_FIGURES]) + more


def figures_of(own: dict[str, ParameterEstimate]) -> list[str]:
    """The parameters of one location; of a periodic error its lines, the largest first, and what is stated of all together."""
    orders, amplitudes = own.get("order"), own.get("amplitude_deg")
    if orders is None or amplitudes is None:
        return [text.reported(name, estimate) for name, estimate in own.items()]
    sizes, _ = amplitudes.components
    _, unit, factor = split_unit("amplitude_deg")
    largest = sorted(range(len(sizes)), key=lambda k: -sizes[k])
    lines = [f"order {orders.only([k])}, amplitude {amplitudes.only([k]).shown(unit, factor)}" for k in largest]
    return [*lines, *(text.reported(name, estimate) for name, estimate in own.items() if name not in LINE)]


def mismatch_in_brief(mismatch: Sequence[MismatchEntry]) -> list[str]:
    """The largest shares in a line."""
    if not mismatch:
        return []
    each = [
        f"{m.at} by {m.depends_on} {percent(m.share)}" + (f" ({CHANNELS[m.channel]})" if m.channel else "") for m in mismatch[:MOST_SHARES]
    ]
    more = f" and {len(mismatch) - MOST_SHARES} more" if len(mismatch) > MOST_SHARES else ""
    return [f"Where model and data disagree (share): {', '.join(each)}{more}"]


def limits_in_brief(d: Diagnosis) -> list[str]:
    """The largest effect that could still hide, and how many more there are."""
    tested = [limit for limit in d.exclusion_limits if limit.tested]
    out = [text.hidden(tested[0])] if tested else []
    out += text.open_lines(d.not_separable[:2], d.advice[1:3])
    if untested := len(d.exclusion_limits) - len(tested):
        out.append(f"Not tested by these poses: {untested} of {len(d.exclusion_limits)} effects and locations")
    return out


def notes_in_brief(notes: Sequence[str]) -> list[str]:
    """The first notes, and in one line the effects that the recording says nothing of."""
    missing = [found[1] for note in notes if (found := _NOT_CONSIDERED.match(note))]
    other = [note for note in notes if not _NOT_CONSIDERED.match(note)]
    out = [f"Note: {note}." for note in other[:MOST_NOTES]]
    out += [f"and {len(other) - MOST_NOTES} more notes"] if len(other) > MOST_NOTES else []
    return [*out, f"Not considered, for lack of data: {', '.join(missing)}"] if missing else out
