"""What a diagnosis finds comes back: into the calibration of a concealed cell, its clouds and predictions, and into steering its arm.

    python benchmarks/effects_loop.py loop [--plan plans/kuka-effects.yaml] [--seeds 3] [--protocols] [--write]
    OMP_NUM_THREADS=1 python benchmarks/effects_loop.py third --write
    python benchmarks/effects_loop.py steered [--drivers simulated,kuka-rsi,kuka-eki] [--out runs/corrected-benchmark]
    OMP_NUM_THREADS=1 python benchmarks/effects_loop.py elsewhere --write
    OMP_NUM_THREADS=1 python benchmarks/effects_loop.py elsewhere --cells 4 --first 100

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import bench
import numpy as np
from bench import HERE, PLANS, changed_plan, keeps, option, put, writes
from effects_loop.elsewhere import cells
from effects_loop.third import third
from mbcacq_fakes.cell.build_world import make_world
from mbcacq_fakes.world.description import from_cell
from mbcacq_fakes.world.options import parse
from scipy.optimize import least_squares

import mbcacq
from mbcacq.calibration.transfer import TransferFigures, check_transfer
from mbcacq.calibration.verification import verification_poses
from mbcacq.challenge import simulated_cells
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.exports.scan_correction import place_scan
from mbcacq.files.atomic_write import write_files
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.json_text import sealed_text
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, expand
from mbcacq.recording.rrd.scan_export import scans_to_write
from mbcacq.spheres.ply import read_cloud
from mbcacq.workflow.corrected_targets import corrected_targets, improvement_of_run

CAPTURE_MM = 1.0  # about a measured sphere, within which points of a cloud belong to it
HIDDEN = [
    {"name": "joint_compliance", "where": "A2", "compliance_rad_per_Nm": 2.0e-6},
    {"name": "joint_compliance", "where": "A3", "compliance_rad_per_Nm": 3.0e-6},
    {"name": "gear_transmission_error", "where": "A4", "order": 2.0, "amplitude_deg": 0.01, "phase_deg": 40.0},
]


def recorded(plan: Path, seed: int, folder: Path | None, shifted: bool = False, hidden: list[dict] = HIDDEN) -> Observations:
    """One run of the concealed cell, through its servers into a folder or by arrays; shifted: at other joint angles, up to 3 deg away, with
    other noise."""
    loaded = mbcacq.load_plan(plan)
    poses, noise_seed = expand(loaded), seed + 1000 if shifted else None
    if shifted:
        rng = np.random.default_rng(seed + 1000)
        poses = [replace(p, q=np.clip(p.q + rng.uniform(-0.05, 0.05, len(p.q)), *loaded.cell.robot.limits.T)) for p in poses]
    scenario = Scenario(seed, "two", seed, tuple(h["name"] for h in hidden), seed, 1.0)
    if folder is None:
        return simulated_cells.observe(loaded, poses, scenario, hidden, noise_seed=noise_seed)[0]
    return simulated_cells.run(loaded, poses, scenario, hidden, folder, noise_seed)[0]


def spacing_of_scans(run: Path, bars: Observations, cell: mbcacq.CalibratedCell, folder: Path) -> float:
    """Mean absolute sphere spacing error (mm) of the bars in clouds that were brought into the base as ``mbcacq apply`` does."""
    write_files(folder, scans_to_write(run))
    result = cell.to_dict()
    radius = dict(zip(bars.cell.ball_ids, np.concatenate([a.diameters for a in bars.cell.artefacts]) / 2, strict=True))
    certified = dict(zip(bars.cell.ball_ids, bars.cell.ball_centres, strict=True))
    ends: dict[int, dict[int, list[np.ndarray]]] = {}
    for m in range(bars.n_centres):
        pose, ball = int(bars.pose[m]), bars.cell.ball_ids[bars.ball[m]]
        points = read_cloud(folder / "scans" / f"{int(bars.pose_id[pose])}.ply")
        near = points[np.abs(np.linalg.norm(points - bars.xyz[m], axis=1) - radius[ball]) < CAPTURE_MM]
        placed, _ = place_scan(result, bars.q[pose], near)
        ends.setdefault(int(bars.station[pose]), {}).setdefault(ball, []).append(centre_of(placed, radius[ball]))
    errors = []
    for balls in ends.values():
        if len(balls) == 2:
            (a, first), (b, second) = balls.items()
            length = np.linalg.norm(np.mean(first, axis=0) - np.mean(second, axis=0))
            errors.append(abs(length - np.linalg.norm(certified[a] - certified[b])))
    return float(np.mean(errors))


def centre_of(points: np.ndarray, radius: float) -> np.ndarray:
    """Centre (3,) of a sphere of known radius through points (N, 3), by least squares from the sphere of any radius."""
    A = np.c_[2 * points, np.ones(len(points))]
    start = np.linalg.lstsq(A, np.sum(points**2, axis=1), rcond=None)[0][:3]
    return least_squares(lambda c: np.linalg.norm(points - c, axis=1) - radius, start, loss="soft_l1", f_scale=0.03).x


def study(plan: Path, seed: int, protocols: bool) -> list[str]:
    """The row of one seed."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        run = folder / "run" if protocols else None
        first, second = recorded(plan, seed, run), recorded(plan, seed, folder / "second" if protocols else None, shifted=True)
        fit = first.select(first.phase != "verification")
        options = mbcacq.CalibrationOptions(refuse=False)
        alone = mbcacq.calibrate(first, options)
        found = mbcacq.diagnose(fit, workers=1)
        names = "; ".join(f"{e.name} {'+'.join(e.where)}" for e in found.effects) or "none"
        if found.model is None:
            return [str(seed), names, *[""] * 11]
        cell = mbcacq.calibrate(first, options, effects=found)
        bars = verification_poses(first)
        spacing = [float(np.abs(mbcacq.verify(bars, c).errors("after")).mean()) for c in (alone, cell)]
        scans = ["", ""]
        if run is not None:
            scans = [f"{spacing_of_scans(run, bars, c, folder):.4f}" for c in (alone, cell)]
        expected = mbcacq.verify(bars, cell).to_dict() or {}
        noise = by_noise_alone(plan, seed, folder / "noise" if protocols else None, options)
        geometry, with_effects = predicted(second, cell, alone.state.chain)
    return [
        str(seed),
        names,
        f"{spacing[0]:.4f}",
        f"{spacing[1]:.4f}",
        *scans,
        f"{expected.get('expected_mean_mm', float('nan')):.4f}",
        *noise[:2],
        f"{geometry.rms_mm:.4f}",
        f"{with_effects.rms_mm:.4f}",
        f"{with_effects.chi2_dof:.2f}",
        noise[2],
    ]


def by_noise_alone(plan: Path, seed: int, folder: Path | None, options: mbcacq.CalibrationOptions) -> list[str]:
    """Errors from noise alone, with nothing concealed and geometry calibrated. They are those of the bar, from centres and from clouds, and
    chi2 per degree of freedom of a second run. The latter contains the uncertainty of the calibration as well.
    """
    calm = recorded(plan, seed, folder, hidden=[])
    cell = mbcacq.calibrate(calm, options)
    bars = verification_poses(calm)
    centres = float(np.abs(mbcacq.verify(bars, cell).errors("after")).mean())
    scans = "" if folder is None else f"{spacing_of_scans(folder, bars, cell, folder / 'scans'):.4f}"
    second = recorded(plan, seed, None if folder is None else folder / "second", shifted=True, hidden=[])
    return [f"{centres:.4f}", scans, f"{predicted(second, cell, cell.state.chain)[1].chi2_dof:.2f}"]


def predicted(second: Observations, cell: mbcacq.CalibratedCell, alone: Chain) -> tuple[TransferFigures, TransferFigures]:
    """What a calibrated cell leaves of a second run with nothing fitted: by the geometry ``alone``, and with its effects."""
    other = second.select(second.phase != "verification")
    known = check_transfer(replace(other, pose_id=other.pose_id + 10_000), cell, alone, place="known")
    return known.geometry_alone, known.with_effects


HEADER = (
    "| seed | found | bar, geometry mm | with effects mm | clouds applied, geometry mm | with effects mm | expected mm | "
    "nothing concealed: bar mm | clouds applied mm | 2nd run, geometry mm | with effects mm | chi2/dof | "
    "nothing concealed: chi2/dof |"
)


def loop(given: argparse.Namespace) -> None:
    """What a diagnosis finds comes back: a cell with concealed compliance and gear errors, calibrated with and without what was found.

    For each seed a fake cell conceals an elastic A2 and A3 and a wavy A4. It is recorded (by arrays; with --protocols through its servers,
    with clouds), calibrated as geometry, diagnosed, and calibrated with the effects. Two figures are printed. The first is the sphere
    spacing errors of the bar, which took part in no fit: from measured centres and, with --protocols, from the clouds themselves brought
    into the base as ``mbcacq apply`` does. The second is about the centres of a second run of the same cell at other poses, with other
    noise. The simulation predicts them with everything held (chi2 per degree of freedom under the stated noise). Beside it stands what
    noise alone leaves: the same of a run that conceals nothing, calibrated as geometry.
    """
    rows = [HEADER, "|---" * 13 + "|"]
    print(*rows, sep="\n", flush=True)
    for seed in range(1, given.seeds + 1):
        rows.append("| " + " | ".join(study(given.plan, seed, given.protocols)) + " |")
        print(rows[-1], flush=True)
    if given.write and given.protocols:
        put(HERE / "effects_loop.md", "\n".join(rows), "<!-- protocols -->\n")


SEED = 7
DRIVERS = {
    "simulated": {"driver": "simulated", "options": {}},
    "kuka-rsi": {"driver": "kuka_rsi", "options": {"bind": "127.0.0.1", "port": 49152, "cycle_ms": 12}},
    "kuka-eki": {"driver": "kuka-eki", "options": {"address": "127.0.0.1", "port": 54610, "tool": 1, "base": 0, "mode": "any"}},
}


# Two places of the artefact where none stood in the calibration, seen from 25 sides each.
PLACES = (("n1", [680, 60, 60], [10, 5, 0]), ("n2", [560, -260, 180], [-25, 0, 10]))


def new_places(folder: Path, driver: str) -> Path:
    """The plan with 50 new places, for a driver."""
    rng = np.random.default_rng(3)
    views = [
        {"tilt_deg": float(rng.uniform(3, 24)), "azimuth_deg": float(rng.uniform(0, 360)), "roll_deg": float(rng.uniform(0, 90))}
        for _ in range(25)
    ]
    rounded = [{key: round(value, 1) for key, value in view.items()} for view in views]

    def change(plan: dict[str, Any]) -> None:
        plan["name"], plan["robot"] = "new places", plan["robot"] | DRIVERS[driver]
        plan["artefacts"], plan["sensors"], plan["exposures"] = plan["artefacts"][:1], [], 1
        plan["stations"] = [
            {"id": name, "artefact": "mbc", "pose_in_base": {"translation_mm": xyz, "abc_deg": abc}} for name, xyz, abc in PLACES
        ]
        ids = [name for name, *_ in PLACES]
        plan["steps"] = [{"name": "new places", "phase": "orientation", "do": "look", "stations": ids, "views": rounded}]
        plan["fake"] = {"hidden": HIDDEN}

    return changed_plan("seeing.yaml", folder / f"{driver}.yaml", change)


def learn(folder: Path) -> tuple[Path, Path]:
    """result.json of the geometry alone and of that with what the diagnosis found."""
    loaded = mbcacq.load_plan(PLANS / "seeing.yaml")
    recorded, _ = observe(loaded, expand(loaded), Scenario(0, "two", SEED, (), SEED, 1.0), HIDDEN)
    geometry = mbcacq.calibrate(recorded)
    better = geometry.with_effects(mbcacq.diagnose(recorded))
    out = []
    for name, cell in (("geometry", geometry), ("effects", better)):
        out.append(folder / f"{name}.json")
        out[-1].write_text(sealed_text(cell.to_dict() | {"simulated": True}))
    return out[0], out[1]


def true_flange(loaded: LoadedPlan, q: np.ndarray, arrivals: int) -> np.ndarray:
    """(P, 4, 4): the world's own flange at reported joint angles q (P, n), with all that it conceals and one draw of repeatability."""
    facts = replace(from_cell(loaded.cell, loaded.plan.scanner.field_of_view), planned_q=q, pace_s=4.0)
    world = make_world(facts, parse({"hidden": HIDDEN}), SEED)
    number = np.arange(len(q))
    station = np.zeros(len(q), dtype=int)
    still = np.zeros_like(q)
    at = world.moments(q, still, still, number + arrivals, 4.0 * number, station, facts.station_artefact[station])
    moved = world.displaced(at)
    return world.scanner_pose(at, moved) @ np.linalg.inv(world.hand_eye)


def missed(there: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """(P,) mm between flanges and places, base and tool adjusted."""
    base, tool, weight = np.zeros(6), np.zeros(6), np.tile([1, 1, 1, 300, 300, 300], len(goals))
    for _ in range(6):
        now = se3.exp(base) @ there @ se3.exp(tool)
        local = se3.inverse(now) @ goals
        left = np.concatenate([local[:, :3, 3], se3.rotation_log(local[:, :3, :3])], axis=1).reshape(-1)
        A = np.concatenate([se3.adjoint(se3.inverse(now)), np.tile(np.eye(6), (len(now), 1, 1))], axis=2).reshape(-1, 12)
        step = np.linalg.lstsq(A * weight[:, None], left * weight)[0]
        base, tool = base + step[:6], tool + step[6:]
    return np.linalg.norm((se3.exp(base) @ there @ se3.exp(tool))[:, :3, 3] - goals[:, :3, 3], axis=1)


def steered(given: argparse.Namespace) -> None:
    """The arm steered by its calibrated model: true errors at 50 new places, as it is, corrected by geometry, and with effects.

    A fake cell conceals an elastic A2 and A3 and a wavy A4 besides its errors of geometry. It is recorded at the places of
    plans/seeing.yaml by the array path, calibrated, diagnosed, and calibrated with what was found. Then it is sent to 50 other places, by
    ``mbcacq.run`` against the fake cell at the wire of each driver. The targets are the plan's own, those corrected by the geometry, and
    those corrected by geometry and effects. The true flange of every recorded pose (the world's own arm, with all it conceals) is compared
    with the place that was meant. Base and tool are adjusted to the 50 places, as a user who teaches a base and a tool does; repeatability
    is that of one arrival, by two at the same joint angles.
    """
    given.out.mkdir(parents=True, exist_ok=True)
    results = given.out / "geometry.json", given.out / "effects.json"
    if not all(r.exists() for r in results):
        learn(given.out)
    print("| driver | targets | rms / µm | median | largest | as the scanner measures it, before → after / µm |\n|---|---|--:|--:|--:|---|")
    for driver in given.drivers.split(","):
        loaded = mbcacq.load_plan(new_places(given.out, driver))
        poses = expand(loaded)
        goals = loaded.cell.robot.chain.flange(np.array([p.q for p in poses]))
        for name in given.targets.split(","):
            result, measured = {"nominal": None, "geometry": results[0], "effects": results[1]}[name], ""
            if given.model_only:
                q = np.array([p.q for p in poses]) if result is None else corrected_targets(loaded, poses, result, True).corrected
            else:
                folder = given.out / f"{driver}-{name}"
                if not (folder / "run.rrd").exists():
                    mbcacq.run(loaded, dry_run=True, seed=SEED, out=folder, corrected=result)
                obs = mbcacq.load_observations(folder)
                q = obs.q
                improved = improvement_of_run(folder, obs)
                if improved is not None:
                    measured = f"{1e3 * improved.before.rms_mm:.0f} → {1e3 * improved.after.rms_mm:.1f}"
            mm = 1e3 * missed(true_flange(loaded, q, 0), goals)
            row = f"| {driver} | {name} | {np.sqrt(np.mean(mm**2)):.1f} | {np.median(mm):.1f} | {mm.max():.1f} | {measured} |"
            print(row, flush=True)
        again = np.linalg.norm((true_flange(loaded, q, 0) - true_flange(loaded, q, 1000))[:, :3, 3], axis=1) * 1e3 / np.sqrt(2)
        print(f"| {driver} | repeatability | {np.sqrt(np.mean(again**2)):.1f} | {np.median(again):.1f} | {again.max():.1f} | |")


if __name__ == "__main__":
    PLAN = option("--plan", type=Path, default=Path("plans/kuka-effects.yaml"))
    LOOP = [PLAN, option("--seeds", type=int, default=3), option("--protocols", action="store_true")]
    COUNT = [option("--cells", type=int, default=40), option("--first", type=int, default=1)]
    bench.main(
        __doc__,
        {
            "loop": (loop, [*LOOP, writes("benchmarks/effects_loop.md")]),
            "elsewhere": (cells, [*COUNT, keeps("elsewhere.jsonl"), writes("benchmarks/elsewhere.md")]),
            "third": (third, [option("--cells", type=int, default=200), *COUNT[1:], keeps("third.jsonl"), writes("benchmarks/third.md")]),
            "steered": (
                steered,
                [
                    option("--drivers", default="simulated,kuka-rsi,kuka-eki"),
                    option("--out", type=Path, default=Path("runs") / "corrected-benchmark"),
                    option("--targets", default="nominal,geometry,effects"),
                    option("--model-only", action="store_true", help="without driving: the true flange at the targets themselves"),
                ],
            ),
        },
    )
