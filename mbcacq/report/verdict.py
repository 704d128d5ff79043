"""The verdict in words, the numbers of the first screen, and the one thing to do next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import bdtrc

from mbcacq.calibration.length_budget import temperature_sentence
from mbcacq.calibration.result_io import export_command, of_flange_poses
from mbcacq.calibration.verification import verdict_of_places
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.errors import command_line
from mbcacq.quantities import K, measured, micrometres, signed, uncertainty
from mbcacq.report.content import Action, ReportVerdict, Spacing

FEWEST_OF_ONE_SIGN = 5
BEYOND_K, RARE = 0.0455, 0.05  # share of normal errors beyond k = 2; what happens less often is no chance
UNITS = {"C": "°C", "s": "s", "ms": "ms", "mm": "mm", "um": "µm", "V": "V", "A": "A"}  # by the ending of a quantity's name
SUSPICIOUS = 1.5  # times the stated noise that the residuals need: something is not in the model
HEADLINES = {
    "pass": "Passed: every place is within the limit",
    "fail": "Not passed: the limit is exceeded",
    "undecided": "Undecided: an error is within the uncertainty of the limit",
}
NO_BUDGET = (
    "Undecided: no uncertainty of judging is known",
    "The result was written by an older mbcacq, without an uncertainty budget: calibrate the recording anew.",
)
VERIFY_INDEPENDENTLY = Action(
    "Verify on poses of their own",
    "The verification poses took part in the calibration: they say how well it fits, not how well it predicts. "
    "Give the bar's step the phase 'verification' and measure again; the plan kuka has such a step.",
    "mbcacq plan copy kuka",
)
MEASURE_MORE = (
    "Measure more, then calibrate again",
    "The limit is exceeded, and no effect was found that explains it. See which "
    "parameters are least certain below, and let the plan be extended by poses that determine them.",
)
DECIDE_BETTER = (
    "Decide with a smaller uncertainty",
    "An error lies within U of the limit. The largest term of the uncertainty budget says what helps: a better certificate, a measured "
    "temperature of the artefact, or more exposures at each end. Then judge anew.",
)
MEASURE_INDEPENDENTLY = Action(
    "Measure an artefact that judges",
    "Nothing independent says how good the cell is. Add a scale bar longer than the view as a step of phase 'verification'; the plan kuka "
    "has one.",
    "mbcacq plan copy kuka",
)
MERGE = (
    "Merge the scans of the part",
    "The part judges the cell: how well its overlapping scans agree, before and after calibration, beside what the cell's uncertainty "
    "lets expect.",
)
HOLD_OUT = (
    "Predict poses that are held out",
    "Nothing independent says how good the cell is. Refit it without some of the poses, and see how well it predicts them.",
)
VERIFY_ON_VIEWS = (
    "Verify on further views",
    "Nothing independent says how good the hand-eye transformation is. Take ten further views of the target, with the flange turned "
    "otherwise than before, and try the result on them. mbcacq data new makes a set of further images, as it made the first.",
)


def verdict_of(spacing: Spacing | None, result: Mapping[str, Any], earlier: Spacing | None = None) -> ReportVerdict:
    """Judge the verification against its limit, each place with the uncertainty of judging it.

    earlier: the same places without the effects, where the result has any.
    """
    fit = result["fit"]
    if spacing is None:
        return ReportVerdict(
            "none",
            "Calibrated, not verified",
            f"No verification artefact was measured. Residual on the poses of the calibration: {micrometres(fit['rms_mm'])} (3D rms).",
        )
    errors = f"{largest_error(spacing)}{_compared(spacing, earlier)}, mean {spacing.mm(np.abs(spacing.after).mean())} mm"
    if spacing.judging is not None and (np.abs(spacing.before) <= K * spacing.judging).all():
        errors += "; these lengths were right before the calibration too, so they do not judge it"
    if spacing.limit is None:
        return ReportVerdict("none", "Calibrated and verified", f"{errors}. The plan sets no limit.")
    if spacing.judging is None:
        return ReportVerdict("undecided", NO_BUDGET[0], f"{errors}; limit {spacing.limit:g} mm. {NO_BUDGET[1]}")
    against = (
        f"{errors}; limit {spacing.limit:g} mm. Decision rule of ISO 14253-1: passed up to the limit minus U, not passed beyond the limit "
        "plus U. Each place has its own U (k = 2)."
    )
    level = verdict_of_places(spacing.after, list(spacing.judging), spacing.limit)
    return ReportVerdict(level, HEADLINES[level], against)


def largest_error(spacing: Spacing) -> str:
    """The largest error with the uncertainty of judging it, and where it is."""
    worst = int(np.abs(spacing.after).argmax())
    U = None if spacing.judging is None else K * spacing.judging[worst]
    value = measured(abs(spacing.after[worst]), U, "mm")
    return f"Largest sphere spacing error {value}{'' if U is None else ' (k = 2)'} at place {spacing.place[worst]}"


def _compared(spacing: Spacing, earlier: Spacing | None) -> str:
    """The largest error before calibration, and without the effects where the cell has them."""
    before = [f"before calibration {spacing.mm(np.abs(spacing.before).max())} mm"]
    if earlier is not None:
        before.append(f"without the effects {spacing.mm(np.abs(earlier.after).max())} mm")
    return f" ({', '.join(before)})"


def beyond_expected_sentence(spacing: Spacing | None) -> str:
    """A sentence on the places whose errors exceed what the calibration expects of itself, or ''."""
    if spacing is None or not spacing.beyond.any() or spacing.sigma is None:
        return ""
    at = [int(i) for i in np.flatnonzero(spacing.beyond)]
    listed = ", ".join(
        f"{spacing.place[i]} ({spacing.mm(abs(float(spacing.after[i])))} against {uncertainty(K * float(spacing.sigma[i]))} mm)"
        for i in at[:5]
    )
    more = f" and {len(at) - 5} more" if len(at) > 5 else ""
    as_many = float(bdtrc(len(at) - 1, len(spacing.place), BEYOND_K))
    lacking = "The model lacks something, or the noise is larger than it was taken to be"
    why = f"Chance alone leaves as many in about {as_many:.0%} of calibrations" if as_many > RARE else lacking
    return (
        f"At {len(at)} of {len(spacing.place)} places the error is beyond the expanded uncertainty that the calibration expects there: "
        f"{listed}{more}. {why}."
    )


def uncertainty_budget(verification: Mapping[str, Any] | None) -> list[tuple[str, str, str]]:
    """(source, standard uncertainty, what it is) of a verified length, the last two rows combined and expanded. The judged quantity, the
    error of the cell, is no part of the uncertainty of judging it."""
    budget = (verification or {}).get("budget")
    if not budget:
        return []
    rows = [
        ("certified distance", "certificate_mm", "of two balls, from the certificate"),
        ("temperature of the artefact", "temperature_mm", temperature_sentence(budget)),
        ("probing of the spheres", "probing_mm", "noise of both centres along the length"),
        ("repeatability of the arm", "repeatability_mm", "of both poses along the length"),
    ]
    out = [(source, f"{uncertainty(budget[key])} mm", what) for source, key, what in rows]
    out.append(("combined, k = 1", f"{uncertainty(budget['combined_mm'])} mm", f"at place {budget['station']}, where it is largest"))
    return [*out, ("expanded, k = 2", f"U = {uncertainty(K * budget['combined_mm'])} mm", "it decides at the limit (ISO 14253-1)")]


def one_sign(spacing: Spacing | None) -> str:
    """A sentence where all errors after calibration have one sign, or ''."""
    if spacing is None or len(spacing.after) < FEWEST_OF_ONE_SIGN:
        return ""
    positive = bool(np.all(spacing.after > 0))
    if not positive and not np.all(spacing.after < 0):
        return ""
    ppm = 1e6 * float(np.mean(spacing.after / spacing.certified))
    count, shared = len(spacing.after), K * (spacing.common or 0.0)
    common = f"They share the uncertainty of the arm, U = {uncertainty(1e3 * shared)} µm (k = 2), which explains it."
    if abs(float(spacing.after.mean())) > shared:
        common = "A common cause acts like this: the certified length, its temperature, or the scale of the scanner."
    return (
        f"All {count} errors are {'positive' if positive else 'negative'}: mean {signed(1e3 * spacing.after.mean(), 1)} µm, "
        f"{signed(ppm, 0)} ppm of the length. "
        f"{common}"
    )


def expected_accuracy(result: Mapping[str, Any]) -> tuple[str, str] | None:
    """Expanded uncertainty (k = 2) of a point in the workspace with its unit, and a remark on the misfit that is in it, or ''.

    The model lacks something unnamed if the residuals need clearly more than the stated noise; a new point is off by it too. The part of
    the residual beyond the stated noise is added in quadrature. None if the result expects nothing.
    """
    expected = result["fit"].get("expected_accuracy_mm")
    if expected is None:
        return None
    factor = max((result.get("noise") or {}).get("check_factor") or [0.0])
    misfit = float(result["fit"]["rms_mm"]) * np.sqrt(1 - 1 / factor**2) if factor > SUSPICIOUS else 0.0
    value = f"{uncertainty(1e3 * K * np.hypot(expected, misfit))} µm"
    return value, f"with {micrometres(misfit)} (3D rms) of the residual that the stated noise does not explain" if misfit else ""


def headlines(spacing: Spacing | None, result: Mapping[str, Any], earlier: Spacing | None = None) -> list[tuple[str, str, str]]:
    """(label, value with unit, remark) of the first screen. earlier: as in ``verdict_of``."""
    fit, out = result["fit"], []
    aside = ", the arm's errors aside" if result.get("scope") else ""
    if spacing is not None:
        worst = int(np.abs(spacing.after).argmax())
        U = None if spacing.judging is None else K * spacing.judging[worst]
        before = _compared(spacing, earlier).strip(" ()")
        remark = before if U is None else f"± is U (k = 2) of judging it; {before}"
        out.append(("largest sphere spacing error", measured(abs(spacing.after[worst]), U, "mm"), remark))
    if (expected := expected_accuracy(result)) is not None:
        value, misfit = expected
        out.append(("expected accuracy of a point", value, f"in the workspace, 3D, U (k = 2){aside}{f', {misfit}' if misfit else ''}"))
    out.append(("residual", micrometres(fit["rms_mm"]), f"3D rms of {fit['centres']} centres, {fit['poses']} poses"))
    return out


def next_action(
    verdict: ReportVerdict,
    spacing: Spacing | None,
    result: Mapping[str, Any],
    found: Diagnosis | None,
    name: str,
    with_effects: str = "",
    plan: str = "",
) -> Action:
    """The one thing to do next, with a command that can be pasted. name: of the run folder or the data; with_effects: the folder of the
    result with the effects found, if ``result`` is that one; plan: the plan of the run, '' if the data have none."""
    if spacing is not None and not spacing.independent:
        return VERIFY_INDEPENDENTLY
    at = with_effects or (name if plan else "result.json")  # a run holds its result, an observation set does not
    if of_flange_poses(result) or result.get("length_instrument"):
        further = "further-set" if result.get("images") else "further-views.csv"
        return Action(*VERIFY_ON_VIEWS, command_line("verify", at, further))
    action = None
    if not with_effects and found is None:
        action = _ask_for_diagnosis(verdict, max(result["noise"].get("check_factor") or [0.0]), name)
    elif not with_effects and found is not None:
        action = _after_diagnosis(verdict, found, name, plan)
    return action or _without_finding(verdict, spacing, name, with_effects, plan, export_command(result, at))


def measure_next(name: str, plan: str) -> str:
    """The command that writes the measurements which decide most, where a run with its plan is there to extend."""
    return command_line("diagnose", name, *(("--next", "next.yaml") if plan else ()))


def _ask_for_diagnosis(verdict: ReportVerdict, factor: float, name: str) -> Action | None:
    """None if nothing is suspicious. factor: noise that the residuals need over the stated noise."""
    if verdict.level == "fail":
        reason = "The limit is exceeded"
    elif factor > SUSPICIOUS:
        reason = f"The residuals need {factor:.1f} times the stated noise"
    else:
        return None
    return Action("Ask why", f"{reason}: something may be missing in the model. Ask what, and where.", command_line("diagnose", name))


def _after_diagnosis(verdict: ReportVerdict, found: Diagnosis, name: str, plan: str) -> Action | None:
    """None if the diagnosis found nothing and advises nothing."""
    if found.verdict in ("explained", "partly_explained", "unexplained"):
        return _after_finding(verdict, found, name, plan)
    if found.rejected_balls:
        return Action("Look at a ball", found.rejected_balls[0].reason, command_line("diagnose", name))
    if found.advice:
        return Action("Measure what is missing", found.advice[0].reason, measure_next(name, plan))
    return None


def _after_finding(verdict: ReportVerdict, found: Diagnosis, name: str, plan: str) -> Action:
    effects = found.effects
    if found.verdict == "unexplained" or not effects or effects[0].name == UNKNOWN:
        at, depends_on = next(((m.at, m.depends_on) for m in found.mismatch), ("the arm", "something not recorded"))
        return Action(
            f"Look at {at}",
            f"The residual structure there depends on {readable(depends_on)}, and no known effect describes it. "
            "A repeated measurement in another order separates a lasting cause from a passing one.",
            measure_next(name, plan),
        )
    named = [e for e in effects if not e.trend] or effects
    names = " and ".join(f"{readable(e.name)} at {', '.join(e.where)}" for e in named[:2])
    what = "Take it into the model" if verdict.level == "pass" else "Repair it, or take it into the model"
    return Action(
        f"{what}: {names}",
        "The diagnosis names it, and it predicts held-out poses. The calibration with it is judged by the same bar.",
        command_line("diagnose", name, "--calibrate"),
    )


def _without_finding(verdict: ReportVerdict, spacing: Spacing | None, name: str, with_effects: str, plan: str, export: str) -> Action:
    """export: the command that writes the result for other programs."""
    if verdict.level == "fail":
        return Action(*MEASURE_MORE, measure_next(name, plan))
    if verdict.level == "undecided":
        return Action(*DECIDE_BETTER, command_line("plan", "check", plan) if plan else command_line("calibrate", name))
    if spacing is None and not plan:  # poses of an instrument without a plan, as of a tracker
        return Action(*HOLD_OUT, command_line("calibrate", name, "--held-out", "random"))
    if spacing is None:
        return MEASURE_INDEPENDENTLY
    why = "Write it for the controller, for ROS or as tables."
    if with_effects:
        why += " These hold the geometry; mbcacq correct and mbcacq apply take the effects into account too."
    return Action("Put the result to use", why, export)


def readable(name: str) -> str:
    return name.replace("_", " ")


def quantity(name: str) -> str:
    """A quantity of a device in words, with its unit: 'temperature, °C' of 'temperature_C'."""
    stem, _, last = name.rpartition("_")
    return readable(stem) + f", {UNITS[last]}" if stem and last in UNITS else readable(name)
