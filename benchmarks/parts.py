"""Cells that are calibrated and checked by the scans of a part, and what else is made of such scans.

Simulated scenes: a true cell with the errors of a usual arm and mount (``DesignOptions``), joints that repeat within 5 urad, and the pose
of the part before the scanner with the noise that scans of a casting have. Real scans, of the fake scanner, are those of ``steps`` and
``memory``.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import bench
import numpy as np
from bench import MBCACQ, PLANS, TESTS, option
from mbcacq_fakes.world.description import ScannerView
from mbcacq_fakes.world.noise import ScannerNoise
from mbcacq_fakes.world.rays import Grid
from mbcacq_fakes.world.scanner import FringeScanner

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.design import part_coverage
from mbcacq.design.options import OPTIONS as DESIGN
from mbcacq.estimation import parameters
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.files.mesh_file import read_mesh
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.interim_check.on_part import with_points
from mbcacq.interim_check.options import UsualChanges
from mbcacq.interim_check.planned_check import PlannedCheck, planned_check
from mbcacq.model import yaml12
from mbcacq.model.observations import Observations
from mbcacq.parts.observations import observations_of_parts
from mbcacq.parts.options import PartOptions
from mbcacq.parts.scene import RegisteredScene
from mbcacq.parts.step import SmoothNoise, rigid_step, smooth_noise
from mbcacq.plan import LoadedPlan, PlannedPose, expand, load
from mbcacq.plan.field_of_view import T_base_scanner, aim_depth
from mbcacq.plan.schema import View
from mbcacq.recording import load_observations
from mbcacq.recording.datasets.observation_writer import write_observation_set
from mbcacq.recording.datasets.scan_folder import write_ply
from mbcacq.workflow.acquire import new_run_folder, plan_acquisition, solver_cell
from mbcacq.workflow.diagnose import diagnose
from mbcacq.workflow.dry_run import device_overrides
from mbcacq.workflow.merge_scans import merge_scans

sys.path[:0] = [str(TESTS / "parts"), str(TESTS / "interim_check")]
SIGMA = np.array([7e-3, 7e-3, 3e-3, 8e-5, 8e-5, 1.8e-4])  # mm, rad
JOINT = 5e-6
COUNT = option("--cells", type=int, default=40, help="number of simulated cells")


def plan_of(places: bool) -> LoadedPlan:
    """plans/part.yaml with its part alone: 30 views at its station, or twelve at each of the five places of the balls."""
    plan = yaml12.load((PLANS / "part.yaml").read_text(encoding="utf-8"))
    balls, part = plan["steps"][2]["views"], plan["steps"][3]
    if places:
        plan["stations"] = [s | {"artefact": "freeform"} for s in plan["stations"] if s["id"] != "part"]
        at = [[-55, -30, 40], [55, 30, 40], [-55, 30, 40], [55, -30, 40], [0, 0, 40]]
        turned = [(10, 0, 45, "positive"), (32, 20, -45, "negative"), (32, 200, 45, "positive"), (18, 110, 80, "negative")]
        balls = [{k: v for k, v in view.items() if k != "shift_mm"} for view in balls]
        balls += [{"tilt_deg": t, "azimuth_deg": a, "roll_deg": r, "wrist": w} for t, a, r, w in turned]
        part["views"] = [view | {"at_mm": at[k % 5]} for k, view in enumerate(balls)]
    else:
        plan["stations"] = [s for s in plan["stations"] if s["id"] == "part"]
    part["stations"], plan["steps"], plan["artefacts"] = [s["id"] for s in plan["stations"]], [part], ["parts/freeform.yaml"]
    return load(PLANS / "part-alone.yaml", yaml12.dump(plan))


def recording(loaded: LoadedPlan, poses: list[PlannedPose], seed: int, links: float) -> tuple[Observations, Chain, np.ndarray]:
    """What scans of the part give in a simulated cell, its arm and its hand-eye transform. links: times the usual errors of an arm.

    Errors that cannot be told from the place of the base or from the hand-eye transform are none.
    """
    rng, cell, q = np.random.default_rng(seed), loaded.cell, np.array([p.q for p in poses])
    ids = [s.id for s in cell.stations]
    station = np.array([ids.index(p.station) for p in poses])
    none = {"pose": np.zeros(0, int), "ball": np.zeros(0, int), "xyz": np.zeros((0, 3))}
    obs = Observations(cell=solver_cell(loaded), pose_id=np.arange(len(q)), station=station, q=q, **none)
    X = cell.T_flange_scanner @ se3.exp(np.array(DESIGN.mounting_errors) * rng.standard_normal(6))
    stood, drawn = q + JOINT * rng.standard_normal(q.shape), links * np.array(DESIGN.parameter_errors) * rng.standard_normal((6, 5))

    def seen(chain: Chain, noise: float) -> Observations:
        T, scenes = chain.frames(stood)[:, -1] @ X, {}
        for s in range(len(ids)):
            at = np.flatnonzero(station == s)
            frame = cell.stations[s].planned_pose @ se3.transform(np.eye(3), np.array([0, 0, 40.0]))
            pose, off = se3.inverse(T[at]) @ frame, noise * SIGMA * rng.standard_normal((len(at), 6))
            pose = se3.transform(se3.rotation_exp(off[:, 3:]) @ pose[:, :3, :3], pose[:, :3, 3] + off[:, :3])
            own = np.broadcast_to(np.diag(SIGMA**2), (len(at), 6, 6))
            scenes[ids[s]] = RegisteredScene(pose, own, np.zeros((len(at), 6, 0)), frame, (), SmoothNoise(0.0, 1.0)), at
        return observations_of_parts(obs, scenes)

    free = parameters.build(seen(cell.robot.chain, 0.0), CalibrationOptions()).blocks[0].free.reshape(-1, 5)
    chain = cell.robot.chain.with_errors(np.where(free, drawn, 0.0))
    return seen(chain, 1.0), chain, X


def hand_eye(args: argparse.Namespace) -> None:
    """Hand-eye transform from 30 scans at one station: error against its covariance (NEES), and against the bound."""
    loaded = plan_of(places=False)
    poses = expand(loaded)
    for links, name in ((0.0, "the arm as described"), (1.0, "an arm with usual errors, taken as nominal")):
        nees, square, stated = [], [], []
        for k in range(args.cells):
            obs, _, X = recording(loaded, poses, 100 + k, links)
            found = calibrate(obs, CalibrationOptions(kinematics=False))
            at = [found.names.index(f"hand_eye.{axis}") for axis in ("x", "y", "z", "rx", "ry", "rz")]
            C, E = found.covariance[np.ix_(at, at)], se3.inverse(found.state.T_flange_scanner) @ X
            off = np.r_[E[:3, 3], se3.rotation_log(E[:3, :3])]
            nees.append(off @ np.linalg.solve(C, off) / 6)
            square.append(off**2)
            stated.append(np.diag(C))
        error, scatter = np.sqrt(np.mean(square, axis=0)), np.std(nees) / np.sqrt(args.cells)
        ratio = np.sqrt(np.mean(np.array(square) / np.array(stated)))
        um, urad = 1e3 * np.linalg.norm(error[:3]), 1e6 * np.linalg.norm(error[3:])
        print(f"{name}: NEES {np.mean(nees):.2f} +- {scatter:.2f}, error over bound {ratio:.2f}; {um:.1f} um, {urad:.0f} urad (3D rms)")


def arm(args: argparse.Namespace) -> None:
    """An arm with usual errors from 60 scans of the part at five places: errors of distances of more than 200 mm, before and after."""
    loaded = plan_of(places=True)
    poses = expand(loaded)
    factors, shares = [], []
    for k in range(args.cells):
        obs, chain, X = recording(loaded, poses, 300 + k, 1.0)
        found = calibrate(obs, CalibrationOptions(refuse=False))
        xyz = np.array([10.0, 20.0, -5.0]) + np.random.default_rng(k).uniform(-30, 30, (obs.n_poses, 3))
        states = (
            (chain, X),
            (loaded.cell.robot.chain, found.preliminary.T_flange_scanner),
            (found.state.chain, found.state.T_flange_scanner),
        )
        place = [se3.apply((c.frames(obs.q)[:, -1] @ T)[:, None], xyz[:, None])[:, 0] for c, T in states]
        i, j = np.triu_indices(obs.n_poses, 1)
        true, before, after = (np.linalg.norm(p[i] - p[j], axis=1) for p in place)
        far = true > 200
        U = 2 * found.distance_uncertainty(obs.q[i], xyz[i], obs.q[j], xyz[j])
        was, now = (np.abs(d - true)[far] for d in (before, after))
        factors.append(was.mean() / now.mean())
        shares.append(np.mean(now < U[far]))
    least, median = np.min(factors), np.median(factors)
    print(
        f"{args.cells} cells: errors smaller by {median:.0f} (median), {least:.1f} at least; {np.mean(shares):.3f} of them within U (k = 2)"
    )


def steps(args: argparse.Namespace) -> None:
    """Steps between two scans of the fake scanner: error against its covariance (NEES), and the share of the scatter that is noise."""
    from test_steps import pairs

    o = PartOptions()
    for shape in ("casting", "blocks", "turned"):
        made = list(pairs(shape, args.pairs, 11))
        noise, each = smooth_noise([cells for cells, _ in made], o), []
        for cells, error in made:
            step = rigid_step(cells, noise, o)
            G = step.determined.T * step.scaled
            off = G @ (step.twist - np.r_[error[:3] + np.cross(error[3:], step.centre), error[3:]])
            each.append(off @ np.linalg.solve(G @ step.covariance @ G.T, off) / len(G))
        named = sum(bool(rigid_step(cells, noise, o).undetermined) for cells, _ in made)
        scatter = np.std(each) / np.sqrt(len(each))
        print(f"{shape}: NEES {np.mean(each):.2f} +- {scatter:.2f}; share {noise.share:.2f}; not determined in {named} of {args.pairs}")


def check_of() -> PlannedCheck:
    """A check by the 30 scans of plans/part.yaml, of a cell that the balls of plans/kuka.yaml calibrated."""
    learnt = load(PLANS / "kuka.yaml")
    observations, _ = observe(learnt, expand(learnt), Scenario(0, "none", 3, (), 1, 1.0), [])
    points, scans = with_points(loaded := load(PLANS / "part.yaml"), expand(loaded))
    return planned_check(points, scans, CalibratedCell.from_dict(calibrate(observations).to_dict()), False, UsualChanges())


def check(args: argparse.Namespace) -> None:
    """False alarms over days without a change, and the looks until a slip of the mount of 0.05 mm in any direction is found."""
    from test_check_on_part import checked, day_of

    planned, looks, alarms, first, second = check_of(), 0, 0, 0, 0
    for k in range(args.cells):
        rng = np.random.default_rng(1000 + k)
        days = [day_of(planned, rng) for _ in range(10)]
        alarms += any(checked(planned, days[:t])[0].changed for t in (2, 4, 7, 10))
        looks += 10
        slip = rng.standard_normal(3)
        days = [*days[:6], *(day_of(planned, rng, 0.05 * slip / np.linalg.norm(slip)) for _ in range(2))]
        at_once = checked(planned, days[:7])[0].changed
        first, second = first + at_once, second + (at_once or checked(planned, days)[0].changed)
        print(f"{k + 1} cells, {looks} looks: {alarms} with an alarm; slips found at once {first}, at the second look {second}", flush=True)


def views(args: argparse.Namespace) -> None:
    """Views that cover the part of plans/part.yaml, beside the best of so many random starts of the same search and a grid of views."""
    loaded, o = load(PLANS / "part.yaml"), DESIGN
    for seed in range(args.cells):
        found = part_coverage.part_views(loaded, "part", None, 40.0, seed, o)
        chosen, rng, starts, drawn = part_coverage.fewest_views(found.shown, o), np.random.default_rng(seed), [], 0
        any_view = found.shown.any(axis=0)
        while len(starts) < args.starts and drawn < 50 * args.starts:
            drawn, kept = drawn + 1, rng.permutation(len(found.shown))[: len(found.shown) * 2 // 3]
            left = found.shown[kept].any(axis=0).sum() / any_view.sum()
            if left >= o.coverage:  # else these views together do not show enough
                starts.append(len(part_coverage.fewest_views(found.shown[kept], replace(o, coverage=o.coverage / left))))
        covered = found.shown[chosen].any(axis=0).sum() / any_view.sum()
        print(
            f"seed {seed}: {len(chosen)} views show {covered:.3f} of what can be seen ({any_view.mean():.3f} of the surface); best of "
            f"{len(starts)} starts {min(starts)}, median {np.median(starts):.0f}; a grid of 9 shows {_grid(loaded, found, seed):.3f}",
            flush=True,
        )


def _grid(loaded: LoadedPlan, found: part_coverage.PartViews, seed: int) -> float:
    """Share of what can be seen that 3 x 3 views from straight above show, evenly over the part."""
    mesh, place = loaded.cell.artefact(loaded.cell.station("part").artefact).mesh, loaded.cell.station("part").planned_pose
    assert mesh is not None
    points, normals = part_coverage._samples(mesh, DESIGN.surface_points, np.random.default_rng(seed))
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    at = [low + (high - low) * [(i + 0.5) / 3, (j + 0.5) / 3, 0.5] for i in range(3) for j in range(3)]
    depth, straight = aim_depth(loaded.plan.scanner.field_of_view), View(tilt_deg=0, azimuth_deg=0)
    T = np.stack([T_base_scanner(place, point, straight, depth) for point in at])
    shown = part_coverage._shown(loaded, mesh, points, normals, se3.inverse(T) @ place, DESIGN).any(axis=0)
    any_view = found.shown.any(axis=0)
    return (shown & any_view).sum() / any_view.sum()


def whole(args: argparse.Namespace) -> None:
    """Dry runs of plans/part.yaml, each of another fake cell, merged and compared with the true mesh."""
    loaded = load(PLANS / "part.yaml")
    poses = expand(loaded)
    for seed in range(args.first, args.first + args.cells):
        with tempfile.TemporaryDirectory(dir=args.folder) as folder:
            run = plan_acquisition(loaded, poses, frozenset(), 0, f"the fake cell of seed {seed}")
            run.folder = new_run_folder(Path(folder) / "run", "part")
            with device_overrides(loaded, poses, dry_run=True, seed=seed, assume_yes=True) as overrides:
                run.execute(overrides, [])
            cell = calibrate(load_observations(run.folder))
            done = merge_scans(run.folder, Path(folder) / "merged.ply", result=cell, cad=PLANS / "parts" / "freeform.stl")
        found, off = done.agreement, done.deviations
        assert off is not None
        nees = np.mean([pair.normalised["geometry"] for pair in found.pairs])
        print(
            f"seed {seed}: before {found.rms_mm('before'):.3f}, after {found.rms_mm('geometry'):.4f}, expected {found.expected_mm:.4f} mm, "
            f"ratio {found.ratio:.3f}, NEES {nees:.2f}; from the mesh: mean {off.mean_mm:+.4f}, rms {off.rms_mm:.4f} "
            f"(expected {off.expected_mm:.4f}) mm, {off.beyond_U:.3f} beyond U",
            flush=True,
        )


def confirm(args: argparse.Namespace) -> None:
    """Concealed elasticity of A2 and A3, found in the balls of plans/concealed.yaml, and tried on 25 scans of a part."""
    plan, part = (yaml12.load((PLANS / f"{name}.yaml").read_text(encoding="utf-8")) for name in ("concealed", "part"))
    plan["artefacts"].append("parts/freeform.yaml")
    plan["stations"].append({"id": "part", "artefact": "freeform", "pose_in_base": {"translation_mm": [760, 0, 120], "abc_deg": [0, 0, 0]}})
    at = [[-50, -25, 40], [50, 25, 40], [-50, 25, 40], [50, -25, 40], [0, 0, 40]]
    ways = [(10, 0, "positive"), (33, 60, "positive"), (30, -60, "negative"), (36, 20, "positive"), (30, 100, "negative")]
    each = [(p, *way) for way in ways for p in at]
    views = [
        {"at_mm": p, "tilt_deg": tilt, "azimuth_deg": 137 * k % 360, "roll_deg": roll, "wrist": wrist}
        for k, (p, tilt, roll, wrist) in enumerate(each)
    ]
    plan["steps"].insert(-1, part["steps"][3] | {"views": views})
    plan["scanner"]["resolution_mm"] = 0.6
    sizes = {"A2": args.compliance * 1e-6, "A3": 1.5 * args.compliance * 1e-6}
    plan["fake"] = {"seed": 1, "hidden": [{"name": "joint_compliance", "where": w, "compliance_rad_per_Nm": s} for w, s in sizes.items()]}
    loaded = load(PLANS / "confirm.yaml", yaml12.dump(plan))
    poses = expand(loaded)
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        run = plan_acquisition(loaded, poses, frozenset(), 0, "the fake cell")
        run.folder = new_run_folder(Path(folder) / "run", "part")
        with device_overrides(loaded, poses, dry_run=True, seed=0, assume_yes=True) as overrides:
            run.execute(overrides, [])
        print(diagnose(run.folder, workers=1).text)


def memory(args: argparse.Namespace) -> None:
    """Peak memory of ``mbcacq merge`` as a whole process, by the number of scans of a million points each."""
    import part_shapes

    loaded = plan_of(places=False)
    poses, cell, rng = expand(loaded), solver_cell(loaded), np.random.default_rng(0)
    mesh = read_mesh(PLANS / "parts" / "freeform.stl")
    fine = Grid.with_pitch(ScannerView(), 0.083)
    part_shapes.SCANNER = FringeScanner(fine, ScannerNoise.for_centres(np.array([0.005, 0.005, 0.009]), 0.012, 12.0))
    known = check_of().cell
    for count in args.scans:
        q = np.array([poses[k % len(poses)].q + np.radians([0, 0, 0, 0, 0, 0.3 * (k // len(poses))]) for k in range(count)])
        none = {"pose": np.zeros(0, int), "ball": np.zeros(0, int), "xyz": np.zeros((0, 3))}
        seen = Observations(cell=cell, pose_id=np.arange(count), station=np.zeros(count, int), q=q, **none)
        T = se3.inverse(loaded.cell.stations[0].planned_pose) @ known.frames(q)[:, -1] @ known.state.T_flange_scanner
        with tempfile.TemporaryDirectory(dir=args.folder) as folder:
            write_observation_set(seen, Path(folder) / "set", {})
            (Path(folder) / "result.json").write_text(json.dumps(known.to_dict()))
            (Path(folder) / "set" / "scans").mkdir()
            for k in range(count):
                points = part_shapes.scan(rng, mesh.vertices[mesh.triangles], T[k])
                write_ply(Path(folder) / "set" / "scans" / f"{k}.ply", points.astype(np.float32))
            begun, command = time.perf_counter(), ["merge", f"{folder}/set", "--result", f"{folder}/result.json"]
            subprocess.run([str(MBCACQ), *command], check=True)
        peak, took = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20, time.perf_counter() - begun
        print(f"{count} million points: {took:.0f} s, peak {peak:.2f} GiB", flush=True)


if __name__ == "__main__":
    raise SystemExit(
        bench.main(
            __doc__,
            {
                "hand-eye": (hand_eye, [COUNT]),
                "arm": (arm, [COUNT]),
                "steps": (steps, [option("--pairs", type=int, default=40, help="pairs of each shape")]),
                "check": (check, [COUNT]),
                "whole": (whole, [COUNT, option("--first", type=int, default=1), option("--folder", type=Path, default=Path())]),
                "confirm": (confirm, [option("--compliance", type=float, default=5.0), option("--folder", type=Path, default=Path())]),
                "views": (views, [option("--cells", type=int, default=3, help="seeds"), option("--starts", type=int, default=50)]),
                "memory": (
                    memory,
                    [option("--scans", type=int, nargs="*", default=[10, 30, 100]), option("--folder", type=Path, default=Path())],
                ),
            },
        )
    )
