"""Plans, effects, recordings and the figure of ``paper.py physics``: what is left out, how large it may be, what a run then records."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from bench import PLANS, line, svg, text
from mbcacq_fakes.cell import computed_run

from mbcacq.model.observations import Observations
from mbcacq.plan import expand, load
from mbcacq.workflow.acquire import solver_cell

NOISE = np.array([0.005, 0.005, 0.009])  # mm, of a ball centre in one exposure
TILTED = [{"tilt_deg": 20, "azimuth_deg": 45 * k, "roll_deg": roll} for k, roll in enumerate((0, 60, -60, 90, -30, 30, -90, 45))]
# Verification: ten places as planned (b), five alike (a), the same five with a short bar (s), the bar steep (v), a gauge of two balls
# that fits into one view (g).
ALIKE = [(600, 0, 100), (600, 0, 200), (600, 0, 0), (650, 0, 150), (550, 0, 50)]
STEEP = [(600, 0, 200), (600, 0, 250), (550, 0, 200)]
BARS = {"short": (300.0, 11), "gauge": (90.0, 13)}
EXTRA_YAML = """id: {name}
uncertainty_mm: 0.001
balls:
  - {{id: {first}, centre_mm: [-{half}, 0, 0], diameter_mm: 12.0}}
  - {{id: {second}, centre_mm: [{half}, 0, 0], diameter_mm: 12.0}}
"""


@dataclass(frozen=True)
class Effect:
    """A left-out effect in one form. options: of the fake cell, for a size in ``unit``; step: size at which the response is measured;
    plausible: largest size that a sound cell of this kind may have; family, form: its names in the table."""

    family: str
    form: str
    unit: str
    step: float
    plausible: float
    name: str
    key: str | None
    fixed: dict[str, Any]
    vector: tuple[float, ...] | None = None

    def hidden(self, size: float) -> list[dict[str, Any]]:
        if self.key is None:  # effects that only know a strength
            return [{"name": self.name, "seed": 3, **self.fixed, "strength": size / self.step}]
        value = size if self.vector is None else [size * v for v in self.vector]
        return [{"name": self.name, "seed": 3, **self.fixed, self.key: value}]


def catalogue() -> list[Effect]:
    """Every effect of the catalogue that acts on an arm at standstill, and those outside it, in their forms."""

    def one(family, form, unit, step, plausible, key, name=None, vector=None, **fixed):
        return Effect(
            family=family, form=form, unit=unit, step=step, plausible=plausible, name=name or family, key=key, fixed=fixed, vector=vector
        )

    out = [one("joint_compliance", a, "rad/Nm", 2e-6, 1e-5, "compliance_rad_per_Nm", where=a) for a in ("A2", "A3")]
    out += [one("joint_compliance", "A5", "rad/Nm", 2e-5, 5e-5, "compliance_rad_per_Nm", where="A5")]
    out += [one("base_compliance", "", "rad/Nm", 5e-7, 2e-6, "compliance_rad_per_Nm")]
    out += [one("mount_compliance", kind, "strength", 1.0, 1.0, None, kind=kind) for kind in ("tilt", "shift")]
    out += [
        one(
            "gear_transmission_error",
            f"{a}, order {order}, phase {phase}",
            "deg",
            0.01,
            0.017,
            "amplitude_deg",
            where=a,
            order=order,
            phase_deg=phase,
        )
        for a in ("A1", "A2", "A3", "A5")
        for order in (1, 2)
        for phase in (0, 90)
    ]
    out += [one("backlash", a, "deg", 0.01, 0.017, "width_deg", where=a) for a in ("A1", "A2", "A3", "A5")]
    out += [one("joint_scale", a, "", 2e-4, 1e-4, "ratio", where=a) for a in ("A1", "A2", "A3", "A4", "A5", "A6")]
    out += [one("wrist_coupling", f"{a}-{b}", "", 5e-4, 1e-3, "ratio", where=[a, b]) for a, b in (("A4", "A5"), ("A4", "A6"), ("A5", "A6"))]
    out += [one("joint_step", f"{a} at pose 44", "deg", 0.01, 0.02, "step_deg", where=a, at_pose=44) for a in ("A1", "A2", "A3", "A5")]
    out += [one("joint_step", f"{a} before the bar", "deg", 0.01, 0.02, "step_deg", where=a, at_pose=76) for a in ("A1", "A2", "A3", "A5")]
    out += [one("thermal_growth", f"{link} in the run", "mm/K", 0.02, 0.03, "growth_mm_per_K", where=link) for link in ("link2", "link4")]
    axes = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    out += [
        one("mount_shift", f"{x} at pose 44", "mm", 0.05, 0.2, "translation_mm", vector=v, at_pose=44, rotation_deg=[0, 0, 0])
        for x, v in axes.items()
    ]
    out += [
        one("mount_shift", f"turn {x} at pose 44", "deg", 0.01, 0.05, "rotation_deg", vector=v, at_pose=44, translation_mm=[0, 0, 0])
        for x, v in axes.items()
    ]
    out += [
        one("mount_shift", f"{x} before the bar", "mm", 0.05, 0.2, "translation_mm", vector=v, at_pose=76, rotation_deg=[0, 0, 0])
        for x, v in axes.items()
    ]
    out += [one("scanner_scale", "all axes", "ppm", 300.0, 500.0, "scale_ppm", vector=(1.0, 1.0, 1.0))]
    out += [one("scanner_scale", f"{x} only", "ppm", 300.0, 500.0, "scale_ppm", vector=v) for x, v in axes.items()]
    out += [one("scanner_distortion", kind, "strength", 1.0, 0.6, None, kind=kind) for kind in ("curvature", "radial", "depth")]
    out += [one("scanner_warmup", x, "mm", 0.05, 0.1, "offset_mm", vector=v, time_constant_s=600) for x, v in axes.items()]
    out += [
        one("ball_shift", f"ball {b}, {x}", "mm", 0.02, 0.01, "shift_mm", vector=v, ball=b) for b in (1, 2, 3, 4) for x, v in axes.items()
    ]
    out += [one("artefact_expansion", "MBC", "ppm", 300.0, 50.0, "scale_ppm", artefact="mbc")]
    out += [one("artefact_expansion", "bar", "ppm", 300.0, 120.0, "scale_ppm", artefact="bar")]
    out += [one("station_drift", f"p3, {x}", "mm", 0.05, 0.1, "drift_mm", vector=v, station="p3") for x, v in axes.items()]
    out += [one("payload", "5 kg more, A2 and A3", "rad/Nm", 2e-6, 1e-5, "compliance_rad_per_Nm", mass_kg=7.3, com_mm=[0, 0, 60])]
    out += [one("exposure_latency", "", "s", 0.01, 0.05, "latency_s")]
    out += [one("arm_warmer_at_bar", "all links, 23 ppm/K", "K", 5.0, 10.0, None)]
    out += [
        one(name, "(outside the catalogue)", "strength", 1.0, 1.0, None)
        for name in (
            "axis_wobble",
            "cable_drag",
            "floor_heave",
            "fringe_ripple",
            "link_bending",
            "loose_anchor",
            "short_memory",
            "incidence_bias",
        )
    ]
    return out


def plans(aims_mm: Sequence[float] = (0.0, 1.0, 3.0, 10.0)) -> dict[str, tuple[Any, list[Any]]]:
    """The plan of this tree is 'tree'. The plan of the paper has tilts of 20 deg and the artefact in the middle of the view. Its aim
    scatters by so many mm along each axis of the scanner: 'aim 3'. 'heights': aim 3, the eight places above one another."""
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (half, first) in ((n, (size / 2, b)) for n, (size, b) in BARS.items()):
            (Path(folder) / f"{name}.yaml").write_text(EXTRA_YAML.format(name=name, half=half, first=first, second=first + 1))
        for name in ("tree", *(f"aim {mm:g}" for mm in aims_mm), "heights"):
            file = Path(folder) / f"{name.replace(' ', '-')}-plan.yaml"
            file.write_text(yaml.safe_dump(_plan(name, Path(folder))))
            loaded = load(file)
            out[name] = loaded, expand(loaded)
    return out


def _plan(name: str, folder: Path) -> dict[str, Any]:
    plan = yaml.safe_load((PLANS / "kuka.yaml").read_text())
    plan["robot"]["model"] = str((PLANS / plan["robot"]["model"]).resolve())
    plan["artefacts"] = [str((PLANS / a).resolve()) for a in plan["artefacts"]] + [str(folder / f"{n}.yaml") for n in BARS]
    steps = {s["name"]: s for s in plan["steps"]}
    if name != "tree":
        at = plan["steps"].index(steps["positions"])
        aim = 3.0 if name == "heights" else float(name.split()[1])
        plan["steps"][at : at + 1] = [_aimed(steps["positions"], s, aim, k) for k, s in enumerate(steps["positions"]["stations"])]
    if name == "heights":
        for k, s in enumerate(s for s in plan["stations"] if s["artefact"] == "mbc"):
            s["pose_in_base"] = {"translation_mm": [650, 0, -300 + 100 * k], "abc_deg": [0, 0, 0]}
    groups = (("a", "bar", ALIKE, 0), ("s", "short", ALIKE, 0), ("v", "bar", STEEP, -75), ("g", "gauge", ALIKE, 0))
    for letter, artefact, places, tilt in groups:
        ids = [f"{letter}{k + 1}" for k in range(len(places))]
        plan["stations"] += [
            {"id": i, "artefact": artefact, "pose_in_base": {"translation_mm": list(p), "abc_deg": [90, tilt, 0]}}
            for i, p in zip(ids, places, strict=True)
        ]
        plan["steps"].append({**steps["bar"], "name": artefact + letter, "stations": ids, "balls": "all" if letter == "g" else "each"})
    return plan


def _aimed(step: dict[str, Any], station: str, aim: float, seed: int) -> dict[str, Any]:
    """The views of one station, the artefact ``aim`` mm (sigma, cut at 1.5) beside the middle of the view."""
    off = aim * np.clip(np.random.default_rng([7, seed]).standard_normal((len(TILTED), 3)), -1.5, 1.5)
    return {
        **step,
        "name": f"position {station}",
        "stations": [station],
        "views": [{**view, "shift_mm": o} for view, o in zip(TILTED, off.round(3).tolist(), strict=True)],
    }


def record(
    loaded: Any,
    poses: Sequence[Any],
    effect: Effect | None,
    size: float,
    seed: int,
    *,
    noise: float = 1.0,
    repeatability_urad: float = 5.0,
    errors: str = "paper",
) -> Observations:
    """One run of one cell; the same seed gives the same cell and the same noise with and without an effect."""
    fake = {"noise_mm": (noise * NOISE).tolist(), "repeatability_urad": repeatability_urad, "errors": errors}
    between = effect is not None and effect.family == "arm_warmer_at_bar"
    hidden = [] if effect is None or between else effect.hidden(size)
    got = computed_run.observe(loaded.cell, poses, hidden, seed, fake=fake)
    phase = np.array([p.phase for p in poses])
    xyz = got.xyz
    if between:
        warm = computed_run.observe(loaded.cell, poses, [], seed, fake={**fake, "errors": _grown(loaded, 23e-6 * size)})
        xyz = np.where((phase == "verification")[got.pose, None], warm.xyz, xyz)
    robot = replace(loaded.cell.robot, repeatability_mm=None)
    cell = replace(solver_cell(loaded), robot=robot, noise_mm=noise * NOISE / np.sqrt(loaded.plan.exposures))
    return Observations(
        cell=cell,
        pose_id=np.array([p.number for p in poses]),
        station=got.station,
        q=got.q,
        pose=got.pose,
        ball=got.ball,
        xyz=xyz,
        phase=phase,
        time_s=got.time_s,
        direction=got.direction.astype(int),
    )


def _grown(loaded: Any, share: float) -> list[list[float]]:
    """The paper's Table 1 (deg, mm) on an arm whose lengths all grew."""
    from mbcacq_fakes.world.arm import paper_errors

    rows = np.array(paper_errors(), dtype=float)
    rows[:, 1:3] += share * loaded.cell.robot.chain.rows[:, 1:3]
    rows[:, [0, 3, 4]] = np.degrees(rows[:, [0, 3, 4]])
    return rows.tolist()


WIDTH, HEIGHT = 860, 470
COLOURS = {"paper": "#b5402a", "ml": "#1f5f99"}


def write_figure(path: Path, report: dict[str, Any], wanted: float) -> None:
    """Left: bar error of cells with nothing left out, by plan. Right: needed share of the plausible size, by effect and plan."""
    path.write_text(svg(WIDTH, HEIGHT, [*_noise(report["noise"], wanted), *_effects(report["effects"])]), encoding="utf-8")


def _noise(rows: list[dict[str, Any]], wanted: float) -> list[str]:
    names = [n for n in ("tree", "aim 10", "aim 3", "aim 1") if any(r["plan"] == n for r in rows)]
    left, right, top, bottom = 52, 380, 46, 420

    def y(mm: float) -> float:
        return bottom - (np.log10(max(mm, 1e-3)) + 3) / 4 * (bottom - top)

    out = [
        text(left, 18, "Nothing left out: |mean error of the bar| per cell, mm", bold=True),
        text(left, 33, "one dot a cell; filled: joints 15 urad, hollow: 5 urad"),
    ]
    for k in range(-3, 2):
        out += [line(left, y(10**k), right, y(10**k), "#ddd"), text(left - 5, y(10**k) + 4, f"{10.0**k:g}", anchor="end")]
    out += [line(left, y(wanted), right, y(wanted), "#000", dash=True), text(left + 3, y(wanted) - 4, "published 0.394")]
    step = (right - left) / len(names)
    for i, name in enumerate(names):
        middle = left + (i + 0.5) * step
        out.append(text(middle, bottom + 16, "plan of this tree" if name == "tree" else f"{name} mm", anchor="middle"))
        for r in (r for r in rows if r["plan"] == name):
            x = middle + (-14 if r["method"] == "paper" else 14) + (5 if r["urad"] > 10 else -5)
            fill = COLOURS[r["method"]] if r["urad"] > 10 else "none"
            out += [
                f'<circle cx="{x:.1f}" cy="{y(abs(m)):.1f}" r="2" fill="{fill}" stroke="{COLOURS[r["method"]]}" stroke-width="0.7"/>'
                for m in r["mean"]
            ]
    return [
        *out,
        text(left, bottom + 36, "paper's method", colour=COLOURS["paper"]),
        text(left + 100, bottom + 36, "maximum likelihood", colour=COLOURS["ml"]),
    ]


def _effects(tables: dict[str, list[dict[str, Any]]]) -> list[str]:
    best: dict[str, dict[str, float]] = {}
    for plan, rows in tables.items():
        for r in rows:
            if r["form"].startswith("(outside"):
                continue
            share = min(r["size"] / r["plausible"], 1e3)
            best.setdefault(r["family"], {})[plan] = min(share, best.get(r["family"], {}).get(plan, np.inf))
    order = sorted(best, key=lambda f: best[f]["tree"])
    left, right, top, bottom = 560, 845, 46, 420

    def x(share: float) -> float:
        return left + (np.log10(np.clip(share, 1e-3, 1e3)) + 3) / 6 * (right - left)

    out = [
        text(415, 18, "Size that adds 0.394 mm, in largest plausible sizes", bold=True),
        text(415, 33, "paper's method; left of 1: a sound cell may have it; at 1000: never"),
    ]
    for k in range(-3, 4):
        out += [
            line(x(10.0**k), top, x(10.0**k), bottom, "#000" if k == 0 else "#ddd"),
            text(x(10.0**k), bottom + 14, f"{10.0**k:g}", anchor="middle"),
        ]
    marks = {"tree": "#000", "aim 10": "#d08a1d", "aim 3": "#7a4fa0"}
    step = (bottom - top) / max(len(order), 1)
    for i, family in enumerate(order):
        y = top + (i + 0.6) * step
        out.append(text(left - 6, y + 3, family, anchor="end"))
        out += [f'<circle cx="{x(s):.1f}" cy="{y:.1f}" r="4" fill="{marks[p]}"/>' for p, s in best[family].items()]
    for i, (plan, colour) in enumerate(marks.items()):
        out.append(text(left + 95 * i, bottom + 34, "plan of this tree" if plan == "tree" else f"{plan} mm", colour=colour))
    return out
