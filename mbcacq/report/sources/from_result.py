"""result.json (format 'mbcacq-result/1') to the content of a report; with the recording at hand, residuals and poses too."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from itertools import count
from typing import Any

import numpy as np

from mbcacq.calibration.clock_term import clock_sentence
from mbcacq.calibration.place_errors import ArmImprovement
from mbcacq.calibration.result_file import FORMAT
from mbcacq.calibration.result_io import ONE_VIEW, axes_of, caveats, noise_of_a_view, of_flange_poses, state_from_dict
from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.errors import ConfigError, command_line
from mbcacq.model.json_text import damage, from_fields
from mbcacq.model.observations import Observations
from mbcacq.quantities import K, capitalised, fixed, in_degrees, listed, micrometres, pair, significant, split_unit, symbol, uncertainty
from mbcacq.report.content import AccuracyGrid, Action, Content, ParameterRow, PartContent, Spacing
from mbcacq.report.sources import measured
from mbcacq.report.sources.coefficients import names_in_words
from mbcacq.report.sources.from_diagnosis import diagnosis_content  # a run without a diagnosis does not wait for these imports
from mbcacq.report.sources.from_motion import kept_motion_content
from mbcacq.report.sources.images import camera_rows, image_rows
from mbcacq.report.sources.run_folder import WITH_EFFECTS
from mbcacq.report.verdict import (
    MERGE,
    SUSPICIOUS,
    beyond_expected_sentence,
    expected_accuracy,
    headlines,
    next_action,
    one_sign,
    uncertainty_budget,
    verdict_of,
)
from mbcacq.version import __version__

GROUPS = (("hand_eye", "Hand-eye corrections"), ("ball_", "Ball centres, within the certificate"), ("effect", "Effects"))
METHODS = {"ml": "maximum likelihood over all observations", "paper": "stage by stage, as published"}


def content_of(result: Mapping[str, Any], observations: Observations | None = None, run_info: Mapping[str, Any] | None = None) -> Content:
    """Everything the report says. Raises ConfigError if the result is not one, or damaged."""
    if not isinstance(result, Mapping) or result.get("format") != FORMAT:
        raise ConfigError(f"this is not a calibration result of format '{FORMAT}'; give the result.json of a calibration")
    try:
        return _content(result, observations, run_info or {})
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise ConfigError(f"the calibration result is damaged ({damage(error)}); write it anew with mbcacq calibrate") from error


def _content(geometry: Mapping[str, Any], observations: Observations | None, run_info: Mapping[str, Any]) -> Content:
    found = {}
    result, folder = best_result(geometry, run_info)
    if observations is not None and observations.n_centres:
        state = state_from_dict(dict(result), observations.cell)
        found["residuals"] = measured.residuals(observations, result, state)
        found["coverage"] = measured.coverage(observations, state)
        found["spheres"] = measured.spheres(observations)
    spacing = spacing_of(result)
    earlier = spacing_of(geometry) if folder else None
    earlier = earlier if earlier is not None and spacing is not None and earlier.place == spacing.place else None
    verdict = verdict_of(spacing, result, earlier)
    document, pictures, name = run_info.get("diagnosis"), run_info.get("pictures"), str(run_info.get("folder") or "RUN")
    diagnosis = None if document is None else Diagnosis.from_json(document)
    if diagnosis is not None and document is not None:
        tried = [from_fields(Transfer, one) for one in document.get("checks", ())]
        found["diagnosis"] = diagnosis_content(diagnosis, pictures, tried)
        found["motion"] = kept_motion_content(document, pictures)
    if (merged := run_info.get("merged")) is not None:
        found["part"] = _part(merged)
    step = next_action(verdict, spacing, result, diagnosis, name, folder, str(run_info.get("plan_path") or ""))
    if merged is None and observations is not None and any(artefact.is_part for artefact in observations.cell.artefacts):
        step = Action(*MERGE, command_line("merge", name))
    return Content(
        title=f"Calibration of {result['robot']['name'] or 'the cell'}",
        subtitle=" · ".join(_when(str(run_info[k])) for k in ("name", "started") if run_info.get(k)) or "hand-eye and kinematics",
        verdict=verdict,
        instrument=_instrument(result),
        headlines=headlines(spacing, result, earlier),
        next=step,
        facts=_facts(result, run_info),
        fit=_fit(result),
        spacing=spacing,
        budget=uncertainty_budget(result.get("verification")),
        one_sign=one_sign(spacing),
        identity=_identity(result, observations, run_info),
        figures=_figures(result.get("verification")),
        parameters=_parameters(result),
        accuracy=_accuracy(result.get("accuracy_map")),
        devices=run_info.get("devices"),
        camera=camera_rows(result["images"]) if result.get("images") else [],
        images=image_rows(result["images"]) if result.get("images") else [],
        earlier=earlier,
        arm_improved=from_fields(ArmImprovement, geometry["arm_improved"]) if geometry.get("arm_improved") else None,
        hand_eye=np.array(result["T_flange_scanner"], dtype=float).reshape(4, 4),
        hand_eye_alone=bool(result.get("scope")),
        noise=_noise(result),
        observability=_observability(result),
        correlation=_correlation(result),
        not_separable=[(" and ".join(names_in_words(c["parameters"])), float(c["correlation"])) for c in result.get("correlated", ())][:20],
        warnings=_warnings(result, spacing),
        caveats=[f"{capitalised(sentence)}." for sentence in caveats(result)],
        versions=[*((str(k), str(v)) for k, v in (run_info.get("versions") or {}).items()), ("report written by", f"mbcacq {__version__}")],
        hashes=list(run_info.get("hashes") or ()),
        plan_yaml=str(run_info.get("plan_yaml") or ""),
        **found,
    )


def _part(merged: Mapping[str, Any]) -> PartContent:
    """A part, of the content of merged.json."""
    agreement, cad = merged["agreement"], merged.get("cad")
    best = list(agreement["rms_mm"])[-1]
    pairs = agreement["pairs"]
    return PartContent(
        sentences=[f"{capitalised(str(one['sentence']))}." for one in (agreement, *([cad] if cad else []))],
        poses=["{}, {}".format(*pair["poses"]) for pair in pairs],
        before_mm=np.array([pair["mm"]["before"] for pair in pairs], dtype=float),
        after_mm=np.array([pair["mm"][best] for pair in pairs], dtype=float),
        expected_mm=np.array([pair["expected_mm"] for pair in pairs], dtype=float),
        **({key: np.array(cad["map"][key], dtype=float) for key in ("x_mm", "y_mm", "deviation_mm")} if cad else {}),
    )


def best_result(geometry: Mapping[str, Any], run_info: Mapping[str, Any]) -> tuple[Mapping[str, Any], str]:
    """The result that a page is about: that with the effects that were found, where the run has one, else the geometry; and its folder,
    '' for the geometry."""
    better = run_info.get("with_effects")
    if not isinstance(better, Mapping) or better.get("format") != FORMAT or not better.get("effects"):
        return geometry, ""
    kept = {key: geometry[key] for key in ("gaps", "simulated", "scope") if key in geometry}
    return {**better, **kept}, f"{run_info.get('folder') or 'RUN'}/{WITH_EFFECTS}"


def spacing_of(result: Mapping[str, Any]) -> Spacing | None:
    """The verification of a result as the page shows it; None where there is none."""
    verification, fitted = result.get("verification"), {str(s["id"]) for s in result["stations"]}
    if verification is None or not (places := verification.get("places")):
        return None
    several = len({p["station"] for p in places}) < len(places)
    expected, judging = ([p.get(key) for p in places] for key in ("expected_mm", "judging_mm"))
    more = []
    if verification.get("expected_mean_mm") is not None:
        more.append(("mean magnitude expected from the fit", f"{uncertainty(verification['expected_mean_mm'])} mm"))
    if (common := verification.get("common_mm")) is not None:
        more.append(("uncertainty of the mean error that all places share, U (k = 2)", f"{uncertainty(K * common)} mm"))
    return Spacing(
        [f"{p['station']}" + (f": {p['balls'][0]}–{p['balls'][1]}" if several else "") for p in places],
        *(np.array([p[key] for p in places], dtype=float) for key in ("certified_mm", "before_mm", "after_mm")),
        sigma=_all_known(expected),
        judging=_all_known(judging),
        limit=verification.get("limit_mm"),
        more=more,
        independent=not any(str(p["station"]) in fitted for p in places),
        common=common,
    )


def _all_known(values: list[Any]) -> np.ndarray | None:
    return None if any(v is None for v in values) else np.array(values, dtype=float)


def _figures(verification: Mapping[str, Any] | None) -> list[tuple[str, str, str, str, str]]:
    """(name, value, expanded uncertainty, limit, verdict) of the figures after the guideline, as texts."""
    words = {"pass": "passed", "fail": "not passed", "undecided": "undecided", "none": "not judged"}

    def name(figure: Mapping[str, Any]) -> str:
        return figure["name"] + (f", largest of {figure['count']}" if figure["count"] > 1 else "")

    return [
        (
            name(f),
            *pair(f["value_mm"], None if f["uncertainty_mm"] is None else K * f["uncertainty_mm"]),
            "–" if f["limit_mm"] is None else f"{f['limit_mm']:g}",
            words[f["verdict"]],
        )
        for f in (verification or {}).get("figures", ())
        if f["value_mm"] is not None
    ]


def _accuracy(data: Mapping[str, Any] | None) -> AccuracyGrid | None:
    if not data or not data["centres_mm"]:
        return None
    centres = np.array(data["centres_mm"], dtype=float).reshape(-1, 3)
    return AccuracyGrid(centres, K * np.array(data["sigma_mm"], dtype=float), float(data["cell_mm"]))


def _when(text: str) -> str:
    """A time of ISO 8601 as date, time and zone; any other text as it is."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        return text
    return f"{when:%Y-%m-%d %H:%M} {when.tzname() or ''}".strip()


def _instrument(result: Mapping[str, Any]) -> str:
    return "instrument" if result.get("measurement") == "target_in_base" else "scanner"


def _facts(result: Mapping[str, Any], run_info: Mapping[str, Any]) -> list[tuple[str, str]]:
    out = [("robot", str(result["robot"]["name"])), ("method", METHODS.get(result["method"], str(result["method"])))]
    if result.get("measurement") == "target_in_base":
        out.append(("measured", "a target on the flange, by an external instrument"))
    out.append(("stations", str(len(result["stations"]))))
    out += [(str(k), str(v)) for k, v in (run_info.get("facts") or {}).items()]
    return out


def _identity(result: Mapping[str, Any], observations: Observations | None, run_info: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What measured and what was measured, as a certificate names it."""
    out = [("robot", str(result["robot"]["name"]))]
    out += [(str(name), str(text)) for name, text in (run_info.get("identity") or {}).items()]
    if observations is not None:
        for artefact in observations.cell.artefacts:
            centre = (
                f"U = {uncertainty(K * artefact.uncertainty_mm)} mm (k = 2) of a coordinate, at {artefact.reference_temperature_C:g} °C"
            )
            out.append((f"artefact {artefact.id}", f"{artefact.name or artefact.id}; {len(artefact.ball_ids)} balls; {centre}"))
    devices = run_info.get("devices")
    for name, low, high, _ in devices.health if devices is not None else ():
        if name.endswith("_C"):
            what = name.removesuffix("_C").removesuffix("temperature").strip("_: ").replace("_", " ")
            out.append((f"temperature, {what}", f"{low} °C" if low == high else f"{low} to {high} °C"))
    if run_info.get("started"):
        out.append(("measured on", _when(str(run_info["started"]))))
    return [*out, ("software", f"mbcacq {__version__}")]


def _fit(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    fit = result["fit"]
    out = [("poses, centres used", f"{fit['poses']}, {fit['centres']}"), ("residual, 3D rms", micrometres(fit["rms_mm"]))]
    if result.get("stated_chi2_dof") is not None:
        out.append(("χ² over degrees of freedom, stated noise", f"{result['stated_chi2_dof']:.3f} ({fit['dof']})"))
    elif fit.get("chi2_dof") is not None:
        out.append(("χ² over degrees of freedom, estimated noise", f"{fit['chi2_dof']:.3f} ({fit['dof']})"))
    held_out = result.get("held_out")
    if held_out:
        out.append(("poses held out, 3D rms", f"{micrometres(held_out['rms_mm'])} ({held_out['poses']} poses, by {held_out['split']})"))
    if (expected := expected_accuracy(result)) is not None:
        value, misfit = expected
        out.append(("expected accuracy of a point, U (k = 2)", f"{value} {misfit}".rstrip()))
    if clock := result.get("clock"):
        out.append(
            ("clock of the scanner", clock_sentence(clock["delay_s"], clock["delay_sigma_s"], clock["drift"]).removeprefix("Clock: "))
        )
    return out


def _parameters(result: Mapping[str, Any]) -> list[ParameterRow]:
    out = []
    # Left out are hundreds of coefficients of basis functions, none of which means anything by itself.
    parameters = [p for p in result["parameters"] if not str(p["name"]).startswith("unknown:")]
    words = names_in_words([str(p["name"]) for p in parameters])
    for p, in_words in zip(parameters, words, strict=True):
        name = str(p["name"])
        unit, factor = _shown_unit(str(p["unit"]))
        rotation = re.fullmatch(r"hand_eye\.r[xyz]", name) is not None
        error, value = factor * float(p["error"]), factor * float(p["value"])
        group = next((title for prefix, title in GROUPS if name.startswith(prefix)), None)
        if group is None:
            group = "Kinematics, MD-H" if re.fullmatch(r"(theta|d|a|alpha|beta)_E?\d+", name) else "Effects"
        uncertainty = None if p.get("std") is None else K * factor * float(p["std"])
        correction_only = rotation or group == "Effects"
        held = str(p.get("reason") or "held") if p["status"] == "held" else None
        nominal, value = (None, None) if correction_only else (value - error, value)
        out.append(
            ParameterRow(
                group=group,
                name=in_words.removeprefix("hand_eye."),
                unit=unit,
                nominal=nominal,
                correction=error,
                value=value,
                uncertainty=uncertainty,
                held=held,
            )
        )
    return out


def _shown_unit(unit: str) -> tuple[str, float]:
    """Symbol of the unit in which a parameter of this one is shown, and how many of that it is."""
    if unit == "rad":
        return "°", in_degrees(1.0)
    _, shown, factor = split_unit(f"_{unit.replace('/', '_per_')}")
    return (shown, factor) if shown else (symbol(unit), 1.0)


def _noise(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    noise, carrier = result["noise"], result["noise"]["joint_rad"]
    if (view := noise_of_a_view(result)) is not None:
        return [(f"one view, scanner and flange together; {ONE_VIEW}", f"{fixed(1e3 * view[0], 1)} µm, {fixed(1e6 * view[1], 1)} µrad")]
    out = [(f"{_instrument(result)}, one centre along x, y, z", listed([1e3 * v for v in noise["scanner_mm"]]) + " µm")]
    if of_flange_poses(result):
        out.append(("poses of the flange, along x, y, z of the base", listed([1e3 * v for v in carrier[:3]]) + " µm"))
        out.append(("poses of the flange, about x, y, z of the base", listed([1e6 * v for v in carrier[3:]]) + " µrad"))
    else:
        slides, axes = set(result["robot"].get("sliding", ())), axes_of(result)
        for kind, unit, factor in (([i for i in range(len(axes)) if i not in slides], "µrad", 1e6), (sorted(slides), "µm", 1e3)):
            if kind:
                values = listed([factor * carrier[i] for i in kind])
                out.append((f"joint repeatability, {', '.join(axes[i] for i in kind)}", f"{values} {unit}"))
    if noise.get("turn_rad") is not None:
        out.append(("orientation of the target", f"{fixed(1e6 * noise['turn_rad'], 1)} µrad"))
    if noise.get("check_factor"):
        out.append((f"found over stated noise of the {_instrument(result)}", ", ".join(f"{v:.2f}" for v in noise["check_factor"])))
    return out


def _observability(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    out = [("rank", f"{result['fit']['rank']} (free parameters and station poses)")]
    indices = result.get("observability")
    if isinstance(indices, Mapping):
        out += [(f"observability index {k}", significant(v) if isinstance(v, int | float) else str(v)) for k, v in indices.items()]
    return out


def _correlation(result: Mapping[str, Any]) -> tuple[list[str], np.ndarray] | None:
    """Names and correlations of all free parameters but the balls, which are as certified but for their uncertainty. Coefficients of
    effects are numbered in the order of their table, so that the names leave room for the picture."""
    names = list(result["names"])
    C = np.array(result["covariance"], dtype=float).reshape(len(names), len(names))
    keep = [i for i, n in enumerate(names) if not n.startswith(("ball_", "unknown:"))]
    if len(keep) < 2:
        return None
    C = C[np.ix_(keep, keep)]
    std = np.sqrt(np.diag(C))
    number = count(1)
    labels = [f"effect {next(number)}" if ":" in names[i] else names[i] for i in keep]
    return labels, C / np.maximum(np.outer(std, std), 1e-300)


def _warnings(result: Mapping[str, Any], spacing: Spacing | None) -> list[str]:
    out = [sentence] if (sentence := beyond_expected_sentence(spacing)) else []
    factor = result["noise"].get("check_factor")
    if factor and max(factor) > SUSPICIOUS:
        out.append(
            f"The residuals need {max(factor):.1f} times the noise that was stated for the {_instrument(result)}: "
            "something is not in the model. mbcacq diagnose looks for it."
        )
    if gaps := result.get("gaps"):
        more = f"; and {len(gaps) - 2} more, under Devices and timing" if len(gaps) > 2 else ""
        out.append(f"About the recording: {'; '.join(map(str, gaps[:2]))}{more}.")
    rejected = result.get("rejected", ())
    if rejected:
        listed = ", ".join(f"pose {r['pose']}" + (f" ball {r['ball']}" if r.get("ball") is not None else "") for r in rejected[:8])
        out.append(f"{len(rejected)} measurements contradict the rest and were left out: {listed}{' …' if len(rejected) > 8 else ''}.")
    if scope := str(result.get("scope") or ""):
        out.append(f"{capitalised(scope)}.")
    return out + [str(w) for w in result.get("warnings", ())]
