"""The diagnosis in plain words."""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq.diagnosis.result import (
    Alternative,
    BetweenRecordings,
    Diagnosis,
    EffectFound,
    ExclusionLimit,
    GeometryAlone,
    NotSeparable,
    Proposal,
)
from mbcacq.effects.effect import ParameterEstimate, in_digits
from mbcacq.effects.in_words import effect_in_words, odds_in_words

VERDICTS = {
    "none": "No effect: the simulation explains the recording down to the measured noise.",
    "explained": "Explained: the effects below bring the simulation down to the measured noise.",
    "partly_explained": "Partly explained: the effects below help, but structure remains.",
    "unexplained": "Unexplained: there is a mismatch that no effect of the catalogue describes.",
    "cannot_tell": "Cannot tell: these poses do not let the candidates be told apart, or be seen.",
}
DIFFERENT = 0.01  # p-value below which recordings are said to differ
MOST_LIMITS = 3  # effects that could still hide, in the text
NOT_DETERMINED = "is not determined"
LARGEST_PHASE_STD_DEG = 90.0
STANDS_IN = "A smooth model stands in its place."
SUSPECTED = "No model of it predicts what was left out: the place below is a suspicion."


def words(d: Diagnosis) -> str:
    """The whole diagnosis as text of several lines."""
    lines = [VERDICTS[d.verdict]]
    if d.verdict == "unexplained":
        lines.append(STANDS_IN if any(e.held_out_gain > 0 for e in d.effects) else SUSPECTED)
    lines.append("")
    if d.mismatch:
        lines.append("Where model and data disagree:")
        lines += [f"  {m.at:<10} depends on {m.depends_on:<18} share {m.share:.0%}" for m in d.mismatch]
        lines.append("")
    for effect in d.effects:
        lines += describe(effect)
    held = d.fit.held_out
    lines += geometry_lines(d.geometry_alone)
    lines.append(
        f"On held-out data (by {held.split}): {held.before_rms_mm:.4f} mm before, {held.after_rms_mm:.4f} mm after; "
        f"chi2/dof {held.before_chi2_dof:.2f} before, {held.after_chi2_dof:.2f} after; "
        f"expected from noise alone: {d.fit.repeatability_floor_mm:.4f} mm."
    )
    lines += proposal_lines(d.proposals)
    lines += [hidden(limit) for limit in d.exclusion_limits[:MOST_LIMITS]]
    lines += [difference(one) for one in d.between_recordings]
    lines += [f"Cannot be told apart: {' and '.join(map(effect_in_words, pair.effects))} ({odds_of(pair)})" for pair in d.not_separable]
    lines += [f"Measure next: {a.reason}" for a in d.advice]
    lines += [f"Note: {note}." for note in d.notes]
    return "\n".join(lines)


def geometry_lines(each: Sequence[GeometryAlone]) -> list[str]:
    """What took part and the noise before any effect, a line for each recording."""
    out = []
    for number, g in enumerate(each, 1):
        which = f", recording {number}" if len(each) > 1 else ""
        instrument = ", ".join(f"{s:.2g}" for s in g.noise.scanner_mm)
        least, most = (_whole(1e6 * v) for v in (min(g.noise.joint_rad), max(g.noise.joint_rad)))
        joints = most if least == most else f"{least} to {most}"
        turn = "" if g.noise.turn_rad is None else f", orientations {_whole(1e6 * g.noise.turn_rad)} urad"
        out.append(f"Geometry alone{which}: {g.poses} poses, {g.centres} centres; noise {instrument} mm{turn}, joints {joints} urad")
    return out


def _whole(value: float) -> str:
    """A whole number; two digits of one below ten."""
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def difference(b: BetweenRecordings) -> str:
    """One parameter over the recordings, in one line."""
    each = ", ".join(f"{in_digits(v)} +- {in_digits(s)}" for v, s in zip(b.values, b.stds, strict=True))
    said = f"{b.parameter} in the recordings: {each}; common {in_digits(b.common)} +- {in_digits(b.common_std)}"
    if b.p_value > DIFFERENT:
        return f"{said}, no difference between them (p = {b.p_value:.2g})"
    causes = "another tool or another stated mass, the temperature, wear"
    return f"{said}, standard deviation between recordings {in_digits(b.between_std)} (p = {b.p_value:.1g}): {causes} could be behind it"


def proposal_lines(proposals: Sequence[Proposal]) -> list[str]:
    """Each formula with its evidence."""
    out = []
    for p in proposals:
        smooth = "" if p.smooth_chi2_dof == p.held_out_before_chi2_dof else f" (a smooth model: {p.smooth_chi2_dof:.2f})"
        out.append(f"Proposed: {p.formula}")
        out.append(
            f"  log Bayes factor {p.log_bayes_factor:.1f}, {odds_in_words(p.odds)}; "
            f"held-out chi2/dof {p.held_out_before_chi2_dof:.2f} -> {p.held_out_chi2_dof:.2f}{smooth}; "
            f"found again in {p.found_in} of {p.parts} searches without a part of the data"
        )
    return out


def hidden(limit: ExclusionLimit) -> str:
    """What could still hide, in one line."""
    at = f"{limit.name} at {'+'.join(limit.where)}"
    if limit.value is None:
        return f"Not excluded at any size: {at}, which the free geometry absorbs"
    size = f"{limit.parameter.rpartition('.')[2]} = {limit.value:.2g}"
    if limit.workspace_mm is None or limit.length_mm is None:
        return f"Not excluded (95 %): {at} up to {size}"
    return f"Not excluded (95 %): {at} up to {size}, {limit.workspace_mm:.2g} mm in the workspace, {limit.length_mm:.2g} mm in a length"


def describe(effect: EffectFound) -> list[str]:
    """The lines of one effect, with an empty one at the end."""
    out = [
        f"{effect_in_words(effect.name)} at {', '.join(effect.where)} (p = {effect.p_value:.1g}, "
        f"removes {effect.held_out_gain:.0%} of the excess over noise)"
    ]
    out += [f"  {name} {_reported(name, estimate)}" for name, estimate in effect.parameters.items()]
    if effect.alternatives:
        out.append(
            "  could also be: "
            + "; ".join(f"{effect_in_words(a.name)} at {', '.join(a.where)} ({likelihood(a)})" for a in effect.alternatives)
        )
    return [*out, ""]


def phase_is_undetermined(name: str, std: float) -> bool:
    """A standard deviation of more than a quarter of a period: the value says nothing, and it would be read as if it did."""
    return name.endswith("phase_deg") and std > LARGEST_PHASE_STD_DEG


def _reported(name: str, estimate: ParameterEstimate) -> str:
    """A parameter with its standard deviation; a phase that has no value as such, where it has one in no harmonic."""
    stds = estimate.std if isinstance(estimate.std, tuple) else (estimate.std,)
    return NOT_DETERMINED if all(phase_is_undetermined(name, s) for s in stds) else f"= {estimate}"


def likelihood(a: Alternative) -> str:
    """How probable an alternative is."""
    if a.odds is None:
        return f"{a.held_out_gain:.0%}"
    return odds_in_words(a.odds)


def odds_of(pair: NotSeparable) -> str:
    """How alike two effects are, and how probable the second is."""
    alike = f"correlation {pair.correlation:.2f}"
    return alike if pair.odds is None else f"{alike}, {odds_in_words(pair.odds)}"


def number(value: float | Sequence[float]) -> str:
    """Four significant digits of a number, or of each component in brackets."""
    return in_digits(tuple(value) if isinstance(value, Sequence) else value)
