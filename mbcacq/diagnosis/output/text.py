"""The diagnosis in plain words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.effect_found import (
    NOT_FOUND_AGAIN,
    REMOVES_NOTHING,
    SELDOM_FOUND,
    Alternative,
    EffectFound,
    MismatchEntry,
    ResponseShape,
)
from mbcacq.diagnosis.findings import TOGETHER, Advice, Findings, NotSeparable
from mbcacq.diagnosis.options import OPTIONS as DIAGNOSIS
from mbcacq.diagnosis.output.figures import beyond_uncertainty
from mbcacq.diagnosis.output.noise_floor import NoiseFloor
from mbcacq.diagnosis.output.repetition import sentences
from mbcacq.diagnosis.result import Diagnosis, ExclusionLimit, GeometryAlone, Proposal
from mbcacq.effects.effect import ParameterEstimate, parameter_in_words
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.effects.in_words import CHANNELS, effect_in_words, odds_in_words
from mbcacq.estimation.several_recordings import BetweenRecordings
from mbcacq.quantities import (
    K,
    fixed,
    in_degrees,
    listed,
    measured,
    micrometres,
    p_value,
    percent,
    significant,
    split_unit,
    uncertainty,
    with_unit,
)

VERDICTS = {
    "none": "No effect: the simulation explains the recording {distance}.",
    "explained": "Explained: the effects below bring the simulation {distance}.",
    "partly_explained": "Partly explained: named effects explain a part of the mismatch; the rest is unmodelled.",
    "unexplained": "Unexplained: there is a mismatch that no effect of the catalogue describes.",
    "cannot_tell": "Cannot tell: these {data} do not separate the candidates, or do not show them.",
}
NOT_TOLD_APART = "Cannot tell: these {data} do not separate the possible causes of the mismatch."
LATE = "Cannot tell: time ran out before all explanations were compared."
OPEN = "Cannot tell: these {data} leave open whether there is an effect."
LOOSE = "Cannot tell: what one ball does is rejected, and no effect is shown beside it."
NO_FIGURE = "Cannot tell: not all of what would explain the mismatch has a reliable figure in these {data}."
NOT_THE_SAME = "Cannot tell: the evidence shows an effect, and parts of the {data} do not find the same one."
TREND_ALONE = "A trend alone: the evidence shows an effect, and it is too weak for a figure."
MOST_NAMED = 4  # effects in the first lines
MOST_LIMITS = 3  # effects that could still hide, in the text
NOT_DETERMINED = "is not determined"
LARGEST_PHASE_STD_DEG = 90.0
STANDS_IN = "A smooth model describes it."
FINDINGS = "Effects, ± U (k = 2):"
TRENDS = "Trends, without a reliable figure:"


def words(d: Diagnosis, calibrated: bool = False) -> str:
    """The whole diagnosis as text of several lines. calibrated: the cell was calibrated with what was found, which is no next step then."""
    floor = noise_floor(d)
    lines = [first_sentence(d, floor)]
    lines += summary_lines(d, floor, calibrated)
    lines.append("")
    lines += mismatch_lines(d.mismatch)
    lines += effect_lines(d.effects, floor.is_excess(d.fit.held_out.before_chi2_dof))
    lines += geometry_lines(d.geometry_alone)
    lines.append(held_out_line(d, floor))
    lines += proposal_lines(d.proposals)
    lines += limit_lines(d.exclusion_limits)
    lines += [difference(one) for one in d.between_recordings]
    lines += open_lines(d.not_separable, d.advice[1:])
    lines += [f"Note: {note}." for note in d.notes]
    return "\n".join(lines)


def first_sentence(d: Findings, floor: NoiseFloor | None = None) -> str:
    """The verdict, with the distance of the model from the noise if it is known. A verdict ``cannot_tell`` names the effects."""
    sentence = VERDICTS[d.verdict]
    if d.out_of_time:
        sentence = LATE
    elif d.verdict == "cannot_tell" and d.not_separable:
        sentence = NOT_TOLD_APART
    elif d.verdict == "cannot_tell" and not d.effects:
        sentence = LOOSE if d.rejected_balls else OPEN
    elif d.verdict in ("explained", "cannot_tell") and d.effects and all(e.trend for e in d.effects):
        sentence = NOT_THE_SAME if all(e.trend in (SELDOM_FOUND, NOT_FOUND_AGAIN) for e in d.effects) else TREND_ALONE
    elif d.verdict == "cannot_tell" and any(e.trend for e in d.effects):
        sentence = NO_FIGURE
    return sentence.format(data=d.data, distance="down to the measured noise" if floor is None else floor.distance)


def held_out_line(d: Diagnosis, floor: NoiseFloor) -> str:
    """The misfit of data that took part in nothing; where nothing was found there is no before and after."""
    held = d.fit.held_out
    rms, chi2 = micrometres(held.before_rms_mm), chi2_in_words(held.before_chi2_dof)
    if d.effects:
        rms, chi2 = f"{rms} before, {micrometres(held.after_rms_mm)} after", f"{chi2} before, {chi2_in_words(held.after_chi2_dof)} after"
    if held.rejects:
        rms = f"{every_centre(d)}; robust {rms} over {held.robust_centres}"
    return f"On held-out data (by {held.split}): {rms}; χ²/dof {chi2}; expected from noise alone: {floor.noise} (k = 2)."


def every_centre(d: Diagnosis) -> str:
    """The misfit of all held-out centres, those as well that the fit of all data rejects."""
    held = d.fit.held_out
    before = micrometres(held.every_before_rms_mm)
    rms = f"{before} before, {micrometres(held.every_after_rms_mm)} after" if d.effects else before
    return f"{rms} over all {held.centres} centres"


def chi2_in_words(chi2_dof: float) -> str:
    """chi2 per degree of freedom; three digits of a large one."""
    return fixed(chi2_dof, 2) if chi2_dof < 100 else significant(chi2_dof, 3)


def mismatch_lines(mismatch: Sequence[MismatchEntry]) -> list[str]:
    """What depends on what, with an empty line at the end."""
    kinds = [f" ({CHANNELS[m.channel]})" if m.channel else "" for m in mismatch]
    lines = [f"  {m.at:<10} depends on {m.depends_on:<18} share {percent(m.share)}{kind}" for m, kind in zip(mismatch, kinds, strict=True)]
    return ["Where model and data disagree:", *lines, ""] if lines else []


def effect_lines(effects: Sequence[EffectFound], excess: bool = True) -> list[str]:
    """The findings, then the trends. excess: whether held-out data have an excess over noise, of which an effect can remove a share."""
    lines = list[str]()
    for heading, some in zip((FINDINGS, TRENDS), findings_and_trends(effects), strict=True):
        lines += [heading] if some else []
        for effect in some:
            lines += describe(effect, excess)
    return lines


def open_lines(not_separable: Sequence[NotSeparable], advice: Sequence[Advice]) -> list[str]:
    """What cannot be told apart, and what to measure next."""
    lines = [f"Cannot be told apart: {pair_in_words(pair)} ({odds_of(pair)})" for pair in not_separable]
    return [*lines, *(f"Measure next: {a.reason}" for a in advice)]


def findings_and_trends(effects: Sequence[EffectFound]) -> tuple[list[EffectFound], list[EffectFound]]:
    """The effects with a figure that may be relied on, and those without one, each in their order."""
    return [e for e in effects if not e.trend], [e for e in effects if e.trend]


def _named(effects: Sequence[EffectFound]) -> str:
    said = [located(e) for e in effects]
    more = f" and {len(said) - MOST_NAMED} more" if len(said) > MOST_NAMED else ""
    return "; ".join(said[:MOST_NAMED]) + more


def located(effect: EffectFound) -> str:
    """The effect and its location; for an unmodelled one also the covariate."""
    of = f" of {effect.depends_on}" if effect.name == UNKNOWN and effect.depends_on else ""
    return f"{effect_in_words(effect.name)}{of} at {', '.join(effect.where)}"


def summary_lines(d: Diagnosis, floor: NoiseFloor, calibrated: bool = False) -> list[str]:
    """What it is and where, how much of the misfit it explains, how sure that is, and what to do next."""
    held = d.fit.held_out
    findings, trends = findings_and_trends(d.effects)
    what = _named(findings) or ("no effect with a reliable figure" if trends else "no effect")
    if d.rejected_balls:
        what = f"{_named(findings) or 'not known'}; {' and '.join(one.reason.partition(' and ')[0] for one in d.rejected_balls)}"
    if d.verdict == "unexplained":
        what += f". {STANDS_IN}"
    # By chi2, as the share of each effect: squares of millimetres also count how uncertain the fit is.
    removed = (held.before_chi2_dof - held.after_chi2_dof) / max(held.before_chi2_dof - 1.0, 1e-9)
    before, after = micrometres(held.before_rms_mm), micrometres(held.after_rms_mm)
    # An excess that is within the uncertainty of the noise has no shares.
    chi2 = f"χ²/dof {chi2_in_words(held.before_chi2_dof)} before, {chi2_in_words(held.after_chi2_dof)} after"
    share = f"{min(max(removed, 0.0), 1.0):.0%} of the misfit beyond noise ({chi2}); " if floor.is_excess(held.before_chi2_dof) else ""
    much = f"{share}{before} before, {after} after" if d.effects else before
    if held.rejects:
        much += f" (robust, over {held.robust_centres} centres; {every_centre(d)})"
    much += f", on held-out data; noise alone leaves {floor.noise} (k = 2)"
    much += ", and an uncertain fit the rest" if floor.fit_is_the_rest else ""
    trend = [f"Trend, too weak for a figure: {_named(trends)}"] if trends else []
    return [f"What and where: {what}", *trend, f"How much: {much}", f"How sure: {how_sure(d)}", f"What next: {what_next(d, calibrated)}"]


def how_sure(d: Diagnosis) -> str:
    """The strongest other explanation of what was found; of nothing found, how much of the catalogue would have shown."""
    if not d.effects:
        usual = [e for e in d.exclusion_limits if e.tested and (e.in_usual_sizes or np.inf) <= 1.0]
        if not d.exclusion_limits:
            return "no exclusion limits are known"
        return f"{len(usual)} of {len(d.exclusion_limits)} effects that were sought are excluded at their usual size (95 %)"
    if d.not_separable:
        pair = max(d.not_separable, key=lambda one: one.odds or 0.0)
        return f"{pair_in_words(pair)} cannot be told apart ({odds_of(pair)})"
    first = next((e for e in d.effects if not e.trend), d.effects[0])
    others = [a for a in first.alternatives if a.odds is not None]
    strongest = max(others, key=lambda a: a.odds or 0.0, default=None)
    if strongest is None:
        alone = "" if first.name == UNKNOWN else "; no other explanation comes near it"  # what is unmodelled may be elsewhere too
        return f"{p_value(first.p_value)} for {located(first)}{alone}"
    other = f"{effect_in_words(strongest.name)} at {', '.join(strongest.where)}"
    return f"the next explanation in place of {located(first)} is {other} ({likelihood(strongest)})"


def what_next(d: Diagnosis, calibrated: bool = False) -> str:
    """One step: what tells the candidates apart, or that what was found be tried."""
    if open_first := what_is_open(d):
        return open_first
    if is_to_be_calibrated_with(d):
        taken = "verify the calibration with what was found on another recording (mbcacq verify), or use it"
        return taken if calibrated else "calibrate with what was found (--calibrate), and try it on another recording (--check)"
    floor = noise_floor(d)
    if floor.fit_is_the_rest and floor.after_mm > DIAGNOSIS.noticeable * floor.floor_mm:
        return f"measure more poses: what these determine predicts others to {micrometres(floor.after_mm)} only"
    return what_could_hide(d.exclusion_limits)


def is_to_be_calibrated_with(d: Diagnosis) -> bool:
    """Whether a calibration with what was found is the next step: something is kept, and nothing has to be done before."""
    return bool(d.model) and not what_is_open(d)


def what_is_open(d: Diagnosis) -> str:
    """What to do before anything found is tried; empty if nothing is open."""
    if d.out_of_time:
        return "give the diagnosis more time (--minutes)"
    if d.advice:
        return d.advice[0].reason
    if d.not_separable:
        return "measure more, at postures that the recording does not have: these poses do not decide between the remaining explanations"
    if differing := [split_unit(b.parameter)[0] for b in d.between_recordings if b.differs]:
        return f"find out why {', '.join(differing)} differs between the recordings: another tool, another stated mass, temperature or wear"
    if d.effects and all(e.trend == REMOVES_NOTHING for e in d.effects):
        return "measure more poses: what was found is too weak to predict held-out data"
    return ""


def what_could_hide(limits: Sequence[ExclusionLimit]) -> str:
    """What to do where nothing was found, or nothing that can be kept."""
    most = next((e for e in limits if e.tested), None)
    if most is None:
        return "measure other postures"
    if most.workspace_mm is None:
        return f"nothing more; the largest effect that could hide is {limited(most)}"
    size = f"{significant(most.workspace_mm, 2)} mm"
    return f"nothing more; if {size} matter, measure postures that show {limited(most)}, the largest effect that could hide"


def noise_floor(d: Diagnosis) -> NoiseFloor:
    """How near the model comes to the noise on held-out data."""
    held, centres = d.fit.held_out, sum(g.centres for g in d.geometry_alone)
    return NoiseFloor.of(held.after_rms_mm, d.fit.repeatability_floor_mm, centres, held.after_chi2_dof)


def geometry_lines(each: Sequence[GeometryAlone]) -> list[str]:
    """What took part and the noise before any effect, a line for each recording."""
    out = []
    for number, g in enumerate(each, 1):
        which = f", recording {number}" if len(each) > 1 else ""
        instrument = listed([1e3 * s for s in g.noise.scanner_mm])
        least, most = (_whole(1e6 * v) for v in (min(g.noise.joint_rad), max(g.noise.joint_rad)))
        joints = most if least == most else f"{least} to {most}"
        turn = "" if g.noise.turn_rad is None else f", orientations {_whole(1e6 * g.noise.turn_rad)} µrad"
        noise = f"noise {instrument} µm along x, y, z{turn}, joints {joints} µrad (k = 1)"
        out.append(f"Geometry alone{which}: {g.poses} poses, {g.centres} centres; {noise}")
    return out


def _whole(value: float) -> str:
    """A whole number; two digits of one below ten."""
    return fixed(value, 0) if value >= 10 else significant(value, 2)


def difference(b: BetweenRecordings) -> str:
    """One parameter over the recordings, in one line."""
    words, unit, factor = split_unit(b.parameter)
    each = ", ".join(measured(factor * v, K * factor * s) for v, s in zip(b.values, b.stds, strict=True))
    said = f"{words} in the recordings: {each}; common {measured(factor * b.common, K * factor * b.common_std, unit)} (± is U, k = 2)"
    if not b.differs:
        return f"{said}, no difference between them ({p_value(b.p_value)})"
    causes = "another tool, another stated mass, the temperature, wear"
    between = f"standard deviation between recordings {uncertainty(factor * b.between_std)} {unit}".rstrip()
    return f"{said}, {between} ({p_value(b.p_value)}); possible causes: {causes}"


def proposal_lines(proposals: Sequence[Proposal]) -> list[str]:
    """Each formula with its evidence."""
    out = []
    for p in proposals:
        smooth = "" if p.smooth_chi2_dof == p.held_out_before_chi2_dof else f" (a smooth model: {p.smooth_chi2_dof:.2f})"
        out.append(f"Proposed: {p.formula}")
        out.append(
            f"  log Bayes factor {p.log_bayes_factor:.1f}, {odds_in_words(p.odds)}; "
            f"held-out χ²/dof {p.held_out_before_chi2_dof:.2f} -> {p.held_out_chi2_dof:.2f}{smooth}; "
            f"found again in {p.found_in} of {p.parts} searches without a part of the data"
        )
    return out


def limit_lines(limits: Sequence[ExclusionLimit]) -> list[str]:
    """The largest effects that could still hide, a line each; those that these poses do not test at all together in one."""
    untested = [limit for limit in limits if not limit.tested]
    out = [hidden(limit) for limit in [limit for limit in limits if limit.tested][:MOST_LIMITS]]
    if untested:
        parameters: dict[str, dict[str, None]] = {}
        for one in untested:
            parameters.setdefault(limited(one), {})[split_unit(one.parameter.rpartition(".")[2])[0]] = None
        listed_ones = [f"{what} ({', '.join(each)})" for what, each in parameters.items()]
        more = f" and {len(listed_ones) - MOST_LIMITS} more" if len(listed_ones) > MOST_LIMITS else ""
        within = f"only an effect of more than {DIAGNOSIS.largest_usual:.0f} times the usual size would show"
        out.append(f"Not tested by these poses ({within}): {'; '.join(listed_ones[:MOST_LIMITS])}{more}")
    return out


def hidden(limit: ExclusionLimit) -> str:
    """What could still hide, in one line."""
    words, unit, factor = split_unit(limit.parameter.rpartition(".")[2])
    size = f"{words} {with_unit(significant(factor * (limit.value or 0.0), 2), unit)}"
    if limit.in_usual_sizes is not None:
        size += f" ({significant(limit.in_usual_sizes, 2)} times the usual size)"
    said = f"Not excluded (95 %): {limited(limit)} up to {size}"
    if limit.workspace_mm is None or limit.length_mm is None:
        return said
    return f"{said}, {significant(limit.workspace_mm, 2)} mm in the workspace, {significant(limit.length_mm, 2)} mm in a length"


def limited(limit: ExclusionLimit) -> str:
    """The effect, its location, and the values of its hyper-parameter for which the limit holds."""
    at = f"{effect_in_words(limit.name)} at {'+'.join(limit.where)}"
    band = limit.holds_for
    if band is None:
        return at
    if band.parameter == "at_pose":
        between = len(band.left_out)
        but = f" (but {between} that these poses hide)" if between else ""
        return f"{at}, beginning at any pose from {band.low:.0f} to {band.high:.0f}{but}"
    words, unit, factor = split_unit(band.parameter)
    low, high = (significant(factor * end, 2) for end in (band.low, band.high))
    return f"{at} of {words} {with_unit(low, unit)}" if low == high else f"{at} of any {words} from {low} to {with_unit(high, unit)}"


def describe(effect: EffectFound, excess: bool = True) -> list[str]:
    """The lines of one effect, with an empty one at the end; a trend has no figure. excess: as ``effect_lines``."""
    at = f"{effect_in_words(effect.name)} at {', '.join(effect.where)}"
    # A share that its uncertainty covers is no figure either.
    share = f", removes {percent(effect.gain_here)} of the excess over noise" if excess and effect.removes else ""
    out = [f"{at} ({p_value(effect.p_value)}{share})"]
    parameters, below = beyond_uncertainty(effect.parameters)
    values = [effect.trend] if effect.trend else [reported(name, estimate) for name, estimate in parameters.items()]
    if below and not effect.trend:
        values.append(f"below the expanded uncertainty: {', '.join(below)}")
    shape = [] if effect.shape is None else [size_of_shape(effect, effect.shape)]
    out += [f"  {line}" for line in (*values, *shape, *sentences(effect))]
    possible = [a for a in effect.alternatives if a.odds is None or a.odds > DIAGNOSIS.undecided]
    excluded = [a for a in effect.alternatives if a not in possible]
    for heading, some in (("could also be", possible), ("excluded in its place", excluded)):
        if some:
            out.append(f"  {heading}: " + "; ".join(f"{effect_in_words(a.name)} at {', '.join(a.where)} ({likelihood(a)})" for a in some))
    return [*out, ""]


def size_of_shape(effect: EffectFound, shape: ResponseShape) -> str:
    """How large an unmodelled effect of a motion is."""
    size = f"{significant(shape.rms)} N·m" if effect.channel == "tau" else f"{significant(float(in_degrees(shape.rms)))}°"
    return f"rms {size}, as a function of {effect.depends_on} ({CHANNELS[effect.channel]})"


def reported(name: str, estimate: ParameterEstimate) -> str:
    """A parameter with its expanded uncertainty; a phase that has no value as such, where it has one in no harmonic."""
    if name.endswith("phase_deg") and all(s > LARGEST_PHASE_STD_DEG for s in estimate.components[1]):
        return f"{split_unit(name)[0]} {NOT_DETERMINED}"
    return parameter_in_words(name, estimate)


def likelihood(a: Alternative) -> str:
    """How probable an alternative is; the share of the mismatch that it would remove where only that is known."""
    if a.odds is None:
        return f"would remove {percent(a.held_out_gain)}"
    return odds_in_words(a.odds)


def pair_in_words(pair: NotSeparable) -> str:
    """Both sides of a pair; 'A alone and together with B' where one side has all effects of the other, 'A together with B and C' else."""
    sides = [list(map(effect_in_words, side.split(TOGETHER))) for side in pair.effects]
    ours, *theirs = sides
    further = [effect for side in theirs for effect in side if effect not in ours]
    if all(set(ours) < set(side) for side in theirs):
        return f"{', '.join(ours)} alone and together with {', '.join(further)}"
    return " and ".join(" together with ".join(side) for side in sides)


def odds_of(pair: NotSeparable) -> str:
    """How alike two effects are, and how probable the second is."""
    alike = f"correlation {pair.correlation:.2f}"
    return alike if pair.odds is None else f"{alike}, {odds_in_words(pair.odds)}"
