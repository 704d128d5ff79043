"""Tables of calibration results for the terminal: deg and mm, as people read them."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.table import Table

TO_DEG = 180 / np.pi


def parameters(result: dict[str, Any]) -> Table:
    """Identified MD-H errors with standard deviations, one row a link, as the paper's Table 1."""
    rows = {p["name"]: p for p in result["parameters"]}
    table = Table(title=f"{result['robot']['name']}: MD-H errors (deg, mm), +- standard deviation", title_justify="left")
    table.add_column("link")
    for name in ("theta", "d", "a", "alpha", "beta"):
        table.add_column(f"{name} {'mm' if name in 'da' else 'deg'}", justify="right")
    for i in range(len(result["robot"]["sign"])):
        table.add_row(str(i + 1), *(_cell(rows.get(f"{p}_{i + 1}")) for p in ("theta", "d", "a", "alpha", "beta")))
    return table


def effects(result: dict[str, Any]) -> list[str]:
    """What the arm does beyond its geometry: the coefficients of each effect, and the groups of the unmodelled effects."""
    terms = (result.get("effects") or {}).get("terms", ())
    if not terms:
        return []
    from mbcacq.workflow.effects import remarks_on_names

    out = ["Effects, with the cell (coefficient +- standard deviation; orders, moments and time constants held):"]
    for t in terms:
        if t["name"] != "unknown":
            hyper = "".join(f", {k} {v:.6g}" for k, v in t["hyper"].items())
            values = ", ".join(f"{c:.4g} +- {s:.2g}" for c, s in zip(t["coefficients"], t["std"], strict=True))
            out.append(f"  {t['name']} at {', '.join(t['where'])}{hyper}: {values} {t['units'][0]}")
    unknown = [t for t in terms if t["name"] == "unknown"]
    if unknown:
        count = sum(len(t["names"]) for t in unknown)
        places = ", ".join(dict.fromkeys("+".join(t["where"]) for t in unknown))
        out.append(f"  unmodelled effect: {len(unknown)} groups of {count} basis functions at {places}")
    return out + [f"  note: {remark}" for remark in remarks_on_names(t["name"] for t in terms)]


def day_to_day(joint: dict[str, Any]) -> list[str]:
    """Each coefficient of the effects in several recordings: what it has in common, and what differs from day to day."""
    out = ["From day to day (common value; standard deviation between recordings; value in each):"] if joint.get("day_to_day") else []
    for d in joint.get("day_to_day") or ():
        each = ", ".join(f"{v:.4g} +- {s:.2g}" for v, s in zip(d["values"], d["std"], strict=True))
        differs = f"differs by {d['between_std']:.2g}" if d["between_std"] > 0 else "does not differ"
        out.append(
            f"  {d['name']} at {', '.join(d['where'])}: {d['common']:.4g} +- {d['common_std']:.2g} {d['unit']}, {differs} "
            f"(p = {d['p_value']:.1g}); {each}"
        )
    return out


def arm_parameters(result: dict[str, Any]) -> set[str]:
    """Names of the MD-H parameters."""
    return {f"{p}_{i + 1}" for p in ("theta", "d", "a", "alpha", "beta") for i in range(len(result["robot"]["sign"]))}


def identifies_arm(result: dict[str, Any]) -> bool:
    """Whether any MD-H parameter was free."""
    arm = arm_parameters(result)
    return any(p["name"] in arm and p["status"] != "held" for p in result["parameters"])


def _cell(parameter: dict[str, Any] | None) -> str:
    if parameter is None or parameter["status"] == "held":
        return "-"
    scale, digits = (TO_DEG, 4) if parameter["unit"] == "rad" else (1.0, 3)
    std = f"\n+-{scale * parameter['std']:.{digits}f}" if parameter["std"] is not None else ""
    return f"{scale * parameter['error']:+.{digits}f}{std}"


def fixed_scanners(result: dict[str, Any]) -> list[Table]:
    """Where an instrument that does not move stands in the base: what a hand-eye calibration of a fixed scanner is for."""
    if result.get("measurement") != "target_in_base":
        return []
    out = []
    for station in result["stations"]:
        table = Table(title=f"instrument '{station['id']}' in the base, X Y Z mm, A B C deg", title_justify="left")
        std = station["std"]
        _frame_rows(table, station["T_base_station"], [f"+-{s:.4f}" for s in std[:3]] + [f"+-{TO_DEG * s:.4f}" for s in std[:2:-1]])
        out.append(table)
    return out


def _frame_rows(table: Table, T: list[list[float]], std: list[str]) -> None:
    """The frame, and the standard deviations below it. Those of the rotation are about the frame's z, y, x axes, near enough to A, B, C
    for reading."""
    from mbcacq.geometry import se3

    xyz, abc = se3.to_abc(np.array(T))
    for name in "XYZABC":
        table.add_column(name, justify="right")
    table.add_row(*(f"{v:.4f}" for v in xyz), *(f"{TO_DEG * v:.4f}" for v in abc))
    table.add_row(*std)


def hand_eye(result: dict[str, Any]) -> Table:
    std = {p["name"]: p["std"] for p in result["parameters"] if p["name"].startswith("hand_eye.")}
    what = "target on the flange" if result.get("measurement") == "target_in_base" else "scanner on the flange (hand-eye)"
    table = Table(title=f"{what}, X Y Z mm, A B C deg", title_justify="left")

    def text(name: str, scale: float) -> str:
        return "held" if std.get(f"hand_eye.{name}") is None else f"+-{scale * std[f'hand_eye.{name}']:.4f}"

    _frame_rows(table, result["T_flange_scanner"], [*(text(c, 1.0) for c in "xyz"), *(text(c, TO_DEG) for c in ("rz", "ry", "rx"))])
    return table


def fit(result: dict[str, Any]) -> list[str]:
    """How well the cell fits, how accurate it is expected to be, and the noise that was found."""
    fitted, noise = result["fit"], result["noise"]
    chi2 = f", chi2/dof {fitted['chi2_dof']:.2f}" if fitted.get("chi2_dof") is not None else ""
    size = f"{fitted['centres']} centres of {fitted['poses']} poses"
    out = [f"Fit: {size}, residual {fitted['rms_mm']:.4f} mm rms{chi2}, rank {fitted['rank']}"]
    if (expected := fitted.get("expected_accuracy_mm")) is not None:
        aside = "noise of measuring aside" if identifies_arm(result) else "noise of measuring and the arm's own errors aside"
        out.append(f"Expected accuracy of a point in the workspace: {expected:.4f} mm (1 sigma, {aside})")
    if noise:
        sigmas = " ".join(f"{1e3 * s:.1f}" for s in noise["scanner_mm"])
        turn = f", its orientation {1e6 * noise['turn_rad']:.1f} urad" if noise.get("turn_rad") else ""
        out.append(f"Noise: scanner {sigmas} um along x y z{turn}{_repeatability(result)}")
        if result["method"] == "paper":
            out.append("The paper's method has no noise model: noise and standard deviations are ours, carried through its equations")
    return out


def _repeatability(result: dict[str, Any]) -> str:
    found = result["noise"]["joint_rad"]
    if not any(found):
        return ""
    if result["robot"].get("flange_poses"):  # displacements in mm, then rotations in rad
        places, turns = (" ".join(f"{s * scale:.1f}" for s in part) for part, scale in ((found[:3], 1e3), (found[3:], 1e6)))
        return f"; poses of the flange are off by {places} um and {turns} urad, one sigma along and about x y z of the base"
    return f"; joints repeat within {' '.join(f'{1e6 * s:.1f}' for s in found)} urad"


def remarks(result: dict[str, Any]) -> list[str]:
    """Held parameters, pairs that the data can hardly separate, rejected measurements, noise that contradicts what was stated."""
    out = []
    if scope := result.get("scope"):
        out.append(f"Scope: {scope}")
    held = result.get("held") or {}
    if not identifies_arm(result):
        arm = arm_parameters(result)
        if not result["robot"].get("flange_poses"):
            out.append(f"Held: the arm's {len(arm)} parameters, at their nominal values")
        held = {name: why for name, why in held.items() if name not in arm}
    reasons: dict[str, list[str]] = {}
    for name, why in held.items():
        reasons.setdefault(why, []).append(name)
    for why, names in reasons.items():
        out.append(f"Held: {', '.join(names)}: {why}")
    for pair in (result.get("correlated") or [])[:5]:
        a, b = pair["parameters"]
        out.append(f"Hard to separate: {a} and {b} (correlation {pair['correlation']:+.3f})")
    rejected = result.get("rejected") or []
    if rejected:
        some = ", ".join(
            f"pose {r['pose']}{'' if r.get('ball') is None else ' ball ' + str(r['ball'])} ({r['distance_mm']:.3f} mm)"
            for r in rejected[:5]
        )
        out.append(f"Rejected as outliers: {len(rejected)}: {some}{', ...' if len(rejected) > 5 else ''}")
    factor = (result.get("noise") or {}).get("check_factor")
    if factor and (max(factor) > 2 or min(factor) < 0.5):
        out.append(f"The scanner's noise is {max(factor, key=lambda f: abs(np.log(f))):.1f} times what was stated")
    return out + [f"Warning: {warning}" for warning in result.get("warnings") or ()]


def scan_scale(result: dict[str, Any]) -> list[str]:
    """The scanner's own scale, and a warning where it differs from the certificate's: no calibration of the arm can observe that."""
    s = result.get("scan_scale")
    if not s:
        return [f"Scale: {result['scale']}"] if result.get("scale") else []
    out = [f"Scale within the scans against the certificate: {s['ppm']:+.0f} +- {s['sigma_ppm']:.0f} ppm ({s['scans']} scans)"]
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
                gains.append(f"{name.replace('_', ' ')} {stage[key]:.4f} -> {stage[f'{name}_after_{unit}']:.4f} {unit}")
            elif key.startswith("change_"):
                gains.append(f"changed by {stage[key]:.3f} {key.removeprefix('change_')}")
        out.append(f"Stage: {stage['stage']}" + (f": {', '.join(gains)}" if gains else ""))
    return out


MOSTLY_COMMON = 2.0  # times what remains of the expected error without it: the common part is what is seen at every place


def figures(v: dict[str, Any]) -> list[str]:
    """Figures after the manner of VDI/VDE 2634 Part 3, and what the expected error at all places has in common."""
    out = common_error(v)
    for f in v.get("figures") or []:
        if f["value_mm"] is not None and f["name"] != "sphere spacing error":
            limit = "" if f["limit_mm"] is None else f", limit {f['limit_mm']:g} mm: {f['verdict']}"
            out.append(f"{f['name'].capitalize()}: {f['value_mm']:.4f} mm, largest of {f['count']}{limit}")
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
        f"Of the expected +-{whole:.3f} mm, +-{common:.3f} mm are common to all places: noise of this calibration appears at each of them "
        "with one sign, as a stretch of the arm would, because the poses hardly see the arm's size. A length longer than the view seen end "
        "by end (phase length), or the artefact in different corners of the view, determines it."
    ]


def verification(v: dict[str, Any]) -> Table:
    """Sphere spacing errors before and after, as the paper's Table 2."""
    table = Table(title="Sphere spacing error (mm)", title_justify="left")
    for name in ("station", "balls", "certified", "before", "after", "expected +-"):
        table.add_column(name, justify="right", no_wrap=True)
    for p in v["places"]:
        expected = "" if p["expected_mm"] is None else f"{p['expected_mm']:.3f}"
        table.add_row(
            str(p["station"]),
            f"{p['balls'][0]}-{p['balls'][1]}",
            f"{p['certified_mm']:.4f}",
            f"{round(p['before_mm'], 3) + 0.0:+.3f}",
            f"{round(p['after_mm'], 3) + 0.0:+.3f}",
            expected,
        )
    table.add_section()
    table.add_row("max", "", "", f"{v['before']['max_mm']:.3f}", f"{v['after']['max_mm']:.3f}", "")
    expected = "" if v.get("expected_mean_mm") is None else f"{v['expected_mean_mm']:.3f}"
    if v.get("independent") is False:
        table.caption = "these poses took part in the calibration"
    table.add_row("mean", "", "", f"{v['before']['mean_mm']:.3f}", f"{v['after']['mean_mm']:.3f}", expected)
    return table


def held_out(h: dict[str, Any]) -> str:
    what = {"station": "Leaving each station out", "random": "Random poses held out", "block": "Blocks of poses held out"}[h["split"]]
    spread = f", spread of each ball {h['spread_mm']:.4f} mm" if h.get("spread_mm") is not None else ""
    gross = f"; {h['gross']} gross, without them {h['rms_without_gross_mm']:.4f} mm" if h["gross"] else ""
    rms = f"{h['rms_mm']:.4f} mm rms (3D){spread}, median {h['median_mm']:.4f}, max {h['max_mm']:.4f}{gross}"
    return f"{what} ({h['fits']} fits, {h['poses']} poses): {rms}"
