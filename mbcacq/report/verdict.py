"""The verdict in words, the numbers of the first screen, and the one thing to do next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbcacq.report.content import Action, ReportVerdict, Spacing

FEWEST_OF_ONE_SIGN = 5
UNITS = {"C": "°C", "s": "s", "ms": "ms", "mm": "mm", "um": "µm", "V": "V", "A": "A"}  # by the ending of a quantity's name
SUSPICIOUS = 1.5  # times the stated noise that the residuals need: something is not in the model
VERIFY_INDEPENDENTLY = Action(
    "Verify on poses of their own",
    "The verification poses took part in the calibration: they say how well it fits, not how well it predicts. "
    "Give the bar's step the phase 'verification' and measure again.",
)
MEASURE_MORE = Action(
    "Measure more, then calibrate again",
    "The limit is exceeded, and no effect was found that explains it. See which "
    "parameters are least certain below, and let the plan be extended by poses that determine them.",
    "mbcacq plan design PLAN",
)
DECIDE_BETTER = Action(
    "Decide with a better certificate or more places",
    "The largest error lies within the uncertainty of the limit: only a smaller uncertainty of the certified distance can decide.",
)
MEASURE_INDEPENDENTLY = Action(
    "Measure an artefact that judges",
    "Nothing independent says how good the cell is. Add a scale bar longer than the view as a step of phase 'verification'.",
)


def verdict_of(spacing: Spacing | None, result: Mapping[str, Any], certificate: float) -> ReportVerdict:
    """Judge the verification against its limit. certificate: standard uncertainty (mm) of a certified distance."""
    fit = result["fit"]
    if spacing is None:
        return ReportVerdict(
            "none",
            "Calibrated, not verified",
            f"No verification artefact was measured. Residual on the poses of the calibration: {fit['rms_mm']:.4f} mm rms.",
        )
    before, after = np.abs(spacing.before), np.abs(spacing.after)
    errors = (
        f"Mean sphere spacing error {after.mean():.3f} mm (before {before.mean():.3f} mm), "
        f"largest {after.max():.3f} mm at place {spacing.place[int(after.argmax())]}"
    )
    if spacing.limit is None:
        return ReportVerdict("none", "Calibrated and verified", f"{errors}. The plan sets no limit.")
    U = 2 * certificate
    against = (
        f"{errors}; limit {spacing.limit:.3f} mm, expanded uncertainty of the certified length U = {U:.4f} mm (k = 2). "
        "Decision rule of ISO 14253-1: passed up to the limit minus U, not passed beyond the limit plus U."
    )
    if after.max() + U <= spacing.limit:
        return ReportVerdict("pass", "Passed: every place is within the limit", against)
    if after.max() - U > spacing.limit:
        return ReportVerdict("fail", "Not passed: the limit is exceeded", against)
    return ReportVerdict("undecided", "Neither proven nor disproven: within the uncertainty of the limit", against)


def uncertainty_budget(spacing: Spacing | None, certificate: float) -> list[tuple[str, str, str]]:
    """(source, standard uncertainty, what it is) of a verified length, the last row combined and expanded. certificate: mm, standard
    uncertainty of a certified distance. What is judged, the error of the cell, is no part of the uncertainty of judging it."""
    if spacing is None:
        return []
    return [
        ("certified distance", f"{certificate:.4f} mm", "of two balls, from the certificate"),
        ("temperature of the artefact", "not included", "the certified length is taken as it stands"),
        ("expanded, k = 2", f"U = {2 * certificate:.4f} mm", "of the length error; it decides at the limit (ISO 14253-1)"),
    ]


def one_sign(spacing: Spacing | None) -> str:
    """A sentence where all errors after calibration have one sign, or ''."""
    if spacing is None or len(spacing.after) < FEWEST_OF_ONE_SIGN:
        return ""
    positive = bool(np.all(spacing.after > 0))
    if not positive and not np.all(spacing.after < 0):
        return ""
    ppm = 1e6 * float(np.mean(spacing.after / spacing.certified))
    count = len(spacing.after)
    return (
        f"All {count} errors are {'positive' if positive else 'negative'}: mean {1e3 * spacing.after.mean():+.1f} µm, {ppm:+.0f} ppm of "
        f"the length. {count} independent errors of mean zero would be of one sign with probability {2.0 ** (1 - count):.1g}. "
        "A common cause acts like this: the certified length, its temperature, or the scale of the scanner."
    )


def headlines(spacing: Spacing | None, result: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(label, value with unit, remark) of the first screen."""
    fit, out = result["fit"], []
    aside = ", the arm's errors aside" if result.get("scope") else ""
    if spacing is not None:
        before, after = np.abs(spacing.before).max(), np.abs(spacing.after)
        worst = int(after.argmax())
        sigma = "" if spacing.sigma is None else f" ± {2 * spacing.sigma[worst]:.3f}"
        out.append(
            (
                "largest sphere spacing error",
                f"{after.max():.3f}{sigma} mm",
                f"before {before:.3f} mm; ± is what the calibration leaves open (k = 2)",
            )
        )
    if fit.get("expected_accuracy_mm") is not None:
        expected = f"{2e3 * fit['expected_accuracy_mm']:.0f} µm"
        out.append(("expected accuracy of a point", expected, f"in the workspace, 3D, U (k = 2){aside}"))
    out.append(("residual", f"{1e3 * fit['rms_mm']:.1f} µm", f"3D rms of {fit['centres']} centres, {fit['poses']} poses"))
    return out


def next_action(
    verdict: ReportVerdict, spacing: Spacing | None, result: Mapping[str, Any], diagnosis: Mapping[str, Any] | None, name: str
) -> Action:
    """The one thing to do next. name: of the run folder or the data, for the commands."""
    if spacing is not None and not spacing.independent:
        return VERIFY_INDEPENDENTLY
    if diagnosis is None:
        action = _ask_for_diagnosis(verdict, max(result["noise"].get("check_factor") or [0.0]), name)
    else:
        action = _after_diagnosis(verdict, diagnosis)
    return action or _without_finding(verdict, spacing, name)


def _ask_for_diagnosis(verdict: ReportVerdict, factor: float, name: str) -> Action | None:
    """None where nothing is suspicious. factor: noise that the residuals need over the stated noise."""
    if verdict.level == "fail":
        reason = "The limit is exceeded"
    elif factor > SUSPICIOUS:
        reason = f"The residuals need {factor:.1f} times the stated noise"
    else:
        return None
    return Action("Ask why", f"{reason}: something may be missing in the model. Ask what, and where.", f"mbcacq diagnose {name}")


def _after_diagnosis(verdict: ReportVerdict, diagnosis: Mapping[str, Any]) -> Action | None:
    """None where the diagnosis found nothing and advises nothing."""
    if diagnosis["verdict"] in ("explained", "partly_explained", "unexplained"):
        return _after_finding(verdict, diagnosis)
    if diagnosis.get("advice"):
        return Action("Measure what is missing", str(diagnosis["advice"][0].get("reason", "")))
    return None


def _after_finding(verdict: ReportVerdict, diagnosis: Mapping[str, Any]) -> Action:
    effects = diagnosis.get("effects") or []
    if diagnosis["verdict"] == "unexplained" or not effects or effects[0]["name"] == "unknown":
        first = (diagnosis.get("mismatch") or [{"at": "the arm", "depends_on": "something not recorded"}])[0]
        return Action(
            f"Look at {first['at']}",
            f"The residual structure there depends on {readable(first['depends_on'])}, and no known effect describes it. "
            "A repeated measurement in another order separates a lasting cause from a passing one.",
        )
    names = " and ".join(f"{readable(e['name'])} at {', '.join(e['where'])}" for e in effects[:2])
    what = "Mind it where you use the cell" if verdict.level == "pass" else "Repair it, or correct for it"
    return Action(
        f"{what}: {names}",
        "The diagnosis names it, and it predicts held-out poses. The section Diagnosis shows its size and its response curve.",
    )


def _without_finding(verdict: ReportVerdict, spacing: Spacing | None, name: str) -> Action:
    if verdict.level == "fail":
        return MEASURE_MORE
    if verdict.level == "undecided":
        return DECIDE_BETTER
    if spacing is None:
        return MEASURE_INDEPENDENTLY
    return Action("Put the result to use", "Write it for the controller, for ROS or as tables.", f"mbcacq export {name} --results DIR")


def readable(name: str) -> str:
    return name.replace("_", " ")


def quantity(name: str) -> str:
    """A quantity of a device in words, with its unit: 'temperature, °C' of 'temperature_C'."""
    stem, _, last = name.rpartition("_")
    return readable(stem) + f", {UNITS[last]}" if stem and last in UNITS else readable(name)
