"""Tables of calibration results for the terminal: ° and mm, every uncertainty expanded (k = 2), as in the report."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.table import Table

from mbcacq.calibration.clock_term import clock_sentence
from mbcacq.calibration.place_errors import ArmImprovement
from mbcacq.calibration.result_io import ONE_VIEW, axes_of, noise_of_a_view, of_flange_poses
from mbcacq.calibration.verification import beyond_expected
from mbcacq.cli.terminal import titled_table
from mbcacq.geometry import se3
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.model.cell import link_parameters
from mbcacq.model.json_text import from_fields
from mbcacq.quantities import (
    K,
    decimal_places,
    fixed,
    in_degrees,
    in_words,
    listed,
    measured,
    micrometres,
    p_value,
    pair,
    signed,
    significant,
    symbol,
    uncertainty,
)
from mbcacq.report.sources.images import camera_rows, image_rows
from mbcacq.report.verdict import expected_accuracy
from mbcacq.report.write import judged
from mbcacq.workflow.effects import remarks_on_names


def parameters(result: dict[str, Any]) -> Table:
    """Identified MD-H errors with expanded uncertainties, one row a link, as the paper's Table 1."""
    rows = {p["name"]: p for p in result["parameters"]}
    headings = ("axis", "θ / °", "d / mm", "a / mm", "α / °", "β / °")
    table = titled_table(f"{result['robot']['name']}: MD-H errors, ± U (k = 2)", *headings, left=["axis"])
    axes, names = axes_of(result), iter(link_parameters(axes_of(result)))
    for axis in axes:
        table.add_row(axis, *(_cell(rows.get(next(names))) for _ in PARAMETERS))
    return table


def effects(result: dict[str, Any]) -> list[str]:
    """What the arm does beyond its geometry: the coefficients of each effect, and the groups of the unmodelled effects."""
    terms = (result.get("effects") or {}).get("terms", ())
    if not terms:
        return []
    out = ["Effects, with the cell (coefficient ± U, k = 2; orders, moments and time constants held):"]
    for t in terms:
        if t["name"] != "unknown":
            hyper = "".join(f", {k} {significant(v, 4)}" for k, v in t["hyper"].items())
            values = ", ".join(measured(c, K * s) for c, s in zip(t["coefficients"], t["std"], strict=True))
            out.append(f"  {t['name']} at {', '.join(t['where'])}{hyper}: {values} {symbol(t['units'][0])}")
    unknown = [t for t in terms if t["name"] == "unknown"]
    if unknown:
        count = sum(len(t["names"]) for t in unknown)
        places = ", ".join(dict.fromkeys("+".join(t["where"]) for t in unknown))
        out.append(f"  unmodelled effect: {len(unknown)} groups of {count} basis functions at {places}")
    return out + [f"  note: {remark}" for remark in remarks_on_names(t["name"] for t in terms)]


def day_to_day(joint: dict[str, Any]) -> list[str]:
    """Each coefficient of the effects in several recordings: what it has in common, and what differs from day to day."""
    out = ["From day to day (common value; standard deviation between recordings; value in each; ± is U, k = 2):"]
    for d in joint.get("day_to_day") or ():
        each = ", ".join(measured(v, K * s) for v, s in zip(d["values"], d["std"], strict=True))
        common = measured(d["common"], K * d["common_std"], symbol(d["unit"]))
        differs = f"differs by {uncertainty(d['between_std'])}" if d["between_std"] > 0 else "does not differ"
        out.append(f"  {d['name']} at {', '.join(d['where'])}: {common}, {differs} ({p_value(d['p_value'])}); {each}")
    return out if len(out) > 1 else []


def arm_parameters(result: dict[str, Any]) -> set[str]:
    """Names of the MD-H parameters."""
    return set(link_parameters(axes_of(result)))


def identifies_arm(result: dict[str, Any]) -> bool:
    """Whether any MD-H parameter was estimated."""
    arm = arm_parameters(result)
    return any(p["name"] in arm and p["status"] in ("free", "prior") for p in result["parameters"])


def link_errors(result: dict[str, Any]) -> str:
    """How far the links of an arm that stays nominal may be off, as the rest of a sentence; '' where that was not asked."""
    found = {unit: [p["std"] for p in result["parameters"] if p["status"] == "marginal" and p["unit"] == unit] for unit in ("mm", "rad")}
    if not all(found.values()):
        return ""
    mm, rad = (float(np.sqrt(np.mean(np.square(found[unit])))) for unit in ("mm", "rad"))
    return (
        f"; they may be off by {uncertainty(1e3 * K * mm)} µm and {uncertainty(1e6 * K * rad)} µrad each (U, k = 2, estimated here), "
        "which every uncertainty takes into account"
    )


def _cell(parameter: dict[str, Any] | None) -> str:
    if parameter is None or parameter["status"] == "held":
        return "-"
    scale = in_degrees(1.0) if parameter["unit"] == "rad" else 1.0
    if parameter["std"] is None:
        return signed(scale * parameter["error"], 4)
    error, U = pair(scale * parameter["error"], K * scale * parameter["std"])
    return f"{'+' if parameter['error'] > 0 else ''}{error}\n± {U}"


def fixed_scanners(result: dict[str, Any]) -> list[Table]:
    """Where an instrument that does not move stands in the base: what a hand-eye calibration of a fixed scanner is for."""
    if result.get("measurement") != "target_in_base":
        return []
    out = []
    for station in result["stations"]:
        std = station["std"]
        turn = [None] * 3 if result.get("length_instrument") else std[:2:-1]  # of one that measures distances there is none
        out.append(_frame_table(f"instrument '{station['id']}' in the base", station["T_base_station"], [*std[:3], *turn]))
    return out


def _frame_table(what: str, T: list[list[float]], std: list[float | None]) -> Table:
    """The frame, and its expanded uncertainties below it.

    std: (6,) standard deviations in mm and rad, None where held. Those of the rotation are about the frame's z, y, x axes, near enough to
    A, B, C for reading.
    """
    xyz, abc = se3.to_abc(np.array(T))
    table = titled_table(f"{what}, ± U (k = 2)", "X / mm", "Y / mm", "Z / mm", "A / °", "B / °", "C / °")
    scaled = [(v, s, 1.0) for v, s in zip(xyz, std[:3], strict=True)]
    scaled += [(in_degrees(v), s, in_degrees(1.0)) for v, s in zip(abc, std[3:], strict=True)]
    shown = [(fixed(v, 4), "held") if s is None else pair(v, K * scale * s) for v, s, scale in scaled]
    table.add_row(*(value for value, _ in shown))
    table.add_row(*(U if U == "held" else f"± {U}" for _, U in shown))
    return table


def hand_eye(result: dict[str, Any]) -> Table:
    std = {p["name"]: p["std"] for p in result["parameters"] if p["name"].startswith("hand_eye.")}
    what = "target on the flange" if result.get("measurement") == "target_in_base" else "scanner on the flange (hand-eye; A B C: z y' x'')"
    return _frame_table(what, result["T_flange_scanner"], [std.get(f"hand_eye.{c}") for c in ("x", "y", "z", "rz", "ry", "rx")])


def fit(result: dict[str, Any]) -> list[str]:
    """How well the cell fits, how accurate it is expected to be, and the noise that was found."""
    fitted, noise = result["fit"], result["noise"]
    chi2 = _chi2(result)
    size = f"{fitted['centres']} centres of {fitted['poses']} poses"
    out = [f"Fit: {size}, residual {micrometres(fitted['rms_mm'])} (3D rms){chi2}, {fitted['rank']} parameters determined"]
    if (expected := expected_accuracy(result)) is not None:
        value, misfit = expected
        known = identifies_arm(result) or link_errors(result)
        aside = "noise of measuring aside" if known else "noise of measuring and the arm's own errors aside"
        out.append(f"Expected accuracy of a point in the workspace: {value} (U, k = 2; {misfit or aside})")
    if noise:
        if (view := noise_of_a_view(result)) is not None:
            place, about = uncertainty(1e3 * view[0]), uncertainty(1e6 * view[1])
            out.append(f"Noise (k = 1): one view is off by {place} µm and {about} µrad, scanner and flange together; {ONE_VIEW}")
            return out
        turn = f", its orientation {uncertainty(1e6 * noise['turn_rad'])} µrad" if noise.get("turn_rad") else ""
        axes = listed([1e3 * s for s in noise["scanner_mm"]])
        distance = f"a distance {uncertainty(1e3 * noise['scanner_mm'][0])} µm"
        scatter = distance if result.get("length_instrument") else f"scanner {axes} µm along x, y, z{turn}"
        out.append(f"Noise (k = 1): {scatter}{_repeatability(result)}")
        if result["method"] == "paper":
            out.append("The paper's method has no noise model: noise and standard deviations are ours, carried through its equations")
    return out


def _chi2(result: dict[str, Any]) -> str:
    """Chi square per degree of freedom under the noise that was stated; under a noise that is estimated from the same residual it says
    nothing."""
    if (stated := result.get("stated_chi2_dof")) is not None:
        return f", χ²/dof {stated:.2f} under the stated noise"
    own = result["fit"].get("chi2_dof")
    return "" if own is None else f", χ²/dof {own:.2f} under the noise that is estimated below"


def _repeatability(result: dict[str, Any]) -> str:
    found = result["noise"]["joint_rad"]
    if not any(found):
        return ""
    if of_flange_poses(result):  # displacements in mm, then rotations in rad
        places, turns = (listed([scale * s for s in part]) for part, scale in ((found[:3], 1e3), (found[3:], 1e6)))
        return f"; poses of the flange are off by {places} µm and {turns} µrad along and about x, y, z of the base"
    slides = set(result["robot"].get("sliding", ()))
    turning = listed([1e6 * s for i, s in enumerate(found) if i not in slides])
    text = f"; joints repeat within {turning} µrad"
    if slides:
        text += f", those that slide within {listed([1e3 * found[i] for i in sorted(slides)])} µm"
    wander = result.get("discrepancy", {}).get("wander_rad")
    return f"{text} about errors that poses after one another share ({listed([1e6 * s for s in wander])} µrad)" if wander else text


def remarks(result: dict[str, Any]) -> list[str]:
    """Held parameters, pairs that the data can hardly separate, rejected measurements, noise that contradicts what was stated."""
    out = []
    if scope := result.get("scope"):
        out.append(f"Scope: {scope}")
    if scale := result.get("scale_from"):
        out.append(f"Scale: {scale}")
    held = result.get("held") or {}
    if not identifies_arm(result):
        arm = arm_parameters(result)
        if not of_flange_poses(result):
            out.append(f"Held: the arm's {len(arm)} parameters, at their nominal values{link_errors(result)}")
        held = {name: why for name, why in held.items() if name not in arm}
    reasons: dict[str, list[str]] = {}
    for name, why in held.items():
        reasons.setdefault(why, []).append(name)
    for why, names in reasons.items():
        out.append(f"Held: {', '.join(names)}: {why}")
    marginal = {p["name"] for p in result["parameters"] if p["status"] == "marginal"}
    for alike in [c for c in result.get("correlated") or [] if not marginal & set(c["parameters"])][:5]:
        a, b = alike["parameters"]
        out.append(f"Hard to separate: {a} and {b} (correlation {signed(alike['correlation'])})")
    rejected = result.get("rejected") or []
    if rejected:
        some = ", ".join(
            f"pose {r['pose']}{'' if r.get('ball') is None else ' ball ' + str(r['ball'])}{_image_of(result, r['pose'])} "
            f"({fixed(r['distance_mm'])} mm)"
            for r in rejected[:5]
        )
        out.append(f"Rejected as outliers: {len(rejected)}: {some}{', ...' if len(rejected) > 5 else ''}")
    factor = (result.get("noise") or {}).get("check_factor")
    if factor and (max(factor) > 2 or min(factor) < 0.5):
        out.append(f"The scanner's noise is {max(factor, key=lambda f: abs(np.log(f))):.1f} times what was stated")
    return out + [f"Warning: {warning}" for warning in result.get("warnings") or ()]


def _image_of(result: dict[str, Any], pose: int) -> str:
    found = next((one["name"] for one in result.get("images", {}).get("images", ()) if one["pose"] == pose), "")
    return f" of {found}" if found else ""


def length_instrument(result: dict[str, Any]) -> list[str]:
    """Offset and scale of an instrument that measures distances."""
    if not (found := result.get("length_instrument")):
        return []
    offset, U = pair(found["offset_mm"], K * found["offset_std_mm"])
    scale, U_scale = pair(1e6 * found["scale"], K * 1e6 * found["scale_std"])
    return [f"Instrument (± U, k = 2): offset {offset} ± {U} mm, scale {scale} ± {U_scale} ppm"]


def images(result: dict[str, Any]) -> list[str]:
    """The camera's intrinsics, and the reprojection error of each image."""
    if not (seen := result.get("images")):
        return []
    errors = ", ".join(f"{name} {rms}" for name, _, rms, _, reason in image_rows(seen) if not reason)
    return [f"Camera (± U, k = 2): {', '.join(f'{n} {v}' for n, v in camera_rows(seen))}", f"Reprojection error (px rms): {errors}"]


def clock(result: dict[str, Any]) -> list[str]:
    """Delay and drift of the clock of a scanner that measured in motion."""
    found = result.get("clock")
    return [clock_sentence(found["delay_s"], found["delay_sigma_s"], found["drift"])] if found else []


def scan_scale(result: dict[str, Any]) -> list[str]:
    """The scanner's own scale, and a warning where it differs from the certificate's: no calibration of the arm can observe that."""
    s = result.get("scan_scale")
    if not s:
        return [f"Scale: {result['scale']}"] if result.get("scale") else []
    out = [f"Scale within the scans against the certificate: {measured(s['ppm'], K * s['sigma_ppm'], 'ppm')} (k = 2, {s['scans']} scans)"]
    if s["significant"]:
        how, sigmas = "longer" if s["ppm"] > 0 else "shorter", abs(s["ppm"]) / s["sigma_ppm"]
        out.append(
            f"Warning: distances within a scan are {how} than certified, at {sigmas:.0f} sigma; the calibration takes this over: "
            f"every distance measured with the cell is wrong by about {abs(s['ppm']) / 1e3:.2f} mm a metre. Check the scanner, the "
            "certificate and the artefact's temperature; mbcacq diagnose estimates it as scanner_scale"
        )
    return out


def stages(result: dict[str, Any]) -> list[str]:
    """What each stage of the paper's method changed."""
    out = []
    for stage in result.get("stages") or []:
        gains = []
        for key in stage:
            if "_before_" in key:
                name, unit = key.split("_before_")
                gains.append(f"{in_words(name)} {significant(stage[key])} -> {significant(stage[f'{name}_after_{unit}'])} {symbol(unit)}")
            elif key.startswith("change_"):
                gains.append(f"changed by {significant(stage[key])} {symbol(key.removeprefix('change_'))}")
        out.append(f"Stage: {stage['stage']}" + (f": {', '.join(gains)}" if gains else ""))
    return out


MOSTLY_COMMON = 2.0  # times what remains of the expected error without it: the common part is what is seen at every place


def figures(v: dict[str, Any]) -> list[str]:
    """Figures after the manner of VDI/VDE 2634 Part 3, and what the expected error at all places has in common."""
    out = common_error(v)
    for f in v.get("figures") or []:
        if f["value_mm"] is not None and f["name"] != "sphere spacing error":
            limit = "" if f["limit_mm"] is None else f", limit {f['limit_mm']:g} mm: {f['verdict']}"
            value = measured(f["value_mm"], None if f["uncertainty_mm"] is None else K * f["uncertainty_mm"], "mm")
            out.append(f"{f['name'].capitalize()}: {value} (k = 2), largest of {f['count']}{limit}")
    return out


def common_error(v: dict[str, Any]) -> list[str]:
    """A sentence where the calibration's own uncertainty is mostly one and the same error at all places."""
    expected = [p["expected_mm"] for p in v["places"] if p["expected_mm"] is not None]
    common = v.get("common_mm")
    if common is None or not expected:
        return []
    whole = float(np.sqrt(np.mean(np.square(expected))))
    if common < MOSTLY_COMMON * np.sqrt(max(whole**2 - common**2, 0.0)):
        return []
    return [
        f"{uncertainty(K * common)} mm of the expected U = {uncertainty(K * whole)} mm (k = 2) are common to all places: noise of this "
        "calibration appears at each of them with one sign, as a stretch of the arm would, because the poses hardly see the arm's size. "
        "A length longer than the view seen end by end (phase length), or the artefact in different corners of the view, determines it."
    ]


def verification(v: dict[str, Any]) -> Table:
    """Sphere spacing errors before and after, as the paper's Table 2, with the uncertainty of judging each and the one expected of it.

    An error beyond what the calibration expects of itself is marked.
    """
    headings = ("station", "balls", "certified", "before", "after", "U of judging", "U expected")
    table = titled_table("Sphere spacing error / mm, U with k = 2", *headings, no_wrap=True)
    known = [p["judging_mm"] for p in v["places"] if p.get("judging_mm")]
    digits = max(decimal_places(K * min(known)), 0) if known else 3
    for p in v["places"]:
        mark = " !" if beyond_expected(p["after_mm"], p["expected_mm"]) else ""
        table.add_row(
            str(p["station"]),
            f"{p['balls'][0]}-{p['balls'][1]}",
            fixed(p["certified_mm"], 4),
            signed(p["before_mm"], digits),
            signed(p["after_mm"], digits),
            uncertainty(K * (p.get("judging_mm") or 0.0)),
            "" if p["expected_mm"] is None else uncertainty(K * p["expected_mm"]) + mark,
        )
    table.add_section()
    table.add_row("max", "", "", fixed(v["before"]["max_mm"], digits), fixed(v["after"]["max_mm"], digits), "", "")
    if v.get("independent") is False:
        table.caption = "these poses took part in the calibration"
    table.add_row("mean", "", "", fixed(v["before"]["mean_mm"], digits), fixed(v["after"]["mean_mm"], digits), "", "")
    return table


def judgement(result: dict[str, Any]) -> list[str]:
    """The verdict in the words of the report, the budget that it rests on, and the places beyond their expected uncertainty."""
    verdict, budget, beyond = judged(result)
    out = [f"{verdict.headline}. {verdict.reason}"]
    if budget:
        out.append("Uncertainty of judging (k = 1): " + "; ".join(f"{source} {value}" for source, value, _ in budget))
        out.append(f"Temperature of the artefact: {budget[1][2]}")
    return [*out, *([f"! {beyond}"] if beyond else [])]


def arm_improved(result: dict[str, Any]) -> list[str]:
    """What corrected targets changed, of a run that a calibrated arm steered."""
    return [from_fields(ArmImprovement, result["arm_improved"]).text] if result.get("arm_improved") else []


def held_out(h: dict[str, Any]) -> str:
    what = {"station": "Leaving each station out", "random": "Random poses held out", "block": "Blocks of poses held out"}[h["split"]]
    spread = f", spread of each ball {micrometres(h['spread_mm'])}" if h.get("spread_mm") is not None else ""
    robust = f"; robust {micrometres(h['rms_without_gross_mm'])} over {h['centres'] - h['gross']}" if h["gross"] else ""
    largest = f"median {micrometres(h['median_mm'])}, largest {micrometres(h['max_mm'])}"
    rms = f"{micrometres(h['rms_mm'])} over {h['centres']} centres (3D rms){robust}{spread}, {largest}"
    return f"{what} ({h['fits']} fits, {h['poses']} poses): {rms}"


SAID = (effects, fit, images, length_instrument, clock, scan_scale, stages, remarks, arm_improved)  # of every result, in this order
