"""How long calibration, ball extraction and inverse kinematics take, with peers in the same run, and how exact they are.

    python benchmarks/speed.py calibration [--poses 104 304 1000 3000] [--repeats 7] [--no-peer] [--pybotics PYTHON] [--figaroh PYTHON]
    python benchmarks/speed.py spheres [--json]
    python benchmarks/speed.py inverse-kinematics [POSES]

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bench
import clouds
import numpy as np
import yaml
from bench import HERE, machine, option
from cells import measure, scanner_cell, tracker_cell
from peer_open3d import open3d

from mbcacq.calibration import CalibrationOptions, Noise, calibrate
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState, predict
from mbcacq.estimation.initial_guess import start
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.parameters import Estimate
from mbcacq.estimation.solver import Weights, solve, system
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.numerical_inverse import NumericalInverse
from mbcacq.model import shipped
from mbcacq.model.cell import RobotModel
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.observations import Observations
from mbcacq.plan.inverse_kinematics import OrthoParallelInverse
from mbcacq.spheres import find_spheres
from mbcacq.spheres.fit import rough_fits, sphere_fits

PEER_POSES, PEER_EVALUATIONS = 120, 8
TRACKER_POSES = 104
MADE_POSES = 1000  # of which larger recordings are repetitions, at stations of their own and with noise of their own
NOISE = Noise(np.array([0.005, 0.005, 0.009]), np.full(6, 8e-6))


def best(function: Callable[[], object], repeats: int) -> float:
    """Smallest processor time in ms: what else the machine does counts little in it."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
    return 1e3 * min(times)


def peer(lineariser: Lineariser, begin: Estimate, weights: Weights, sparse: bool) -> float:
    """One run of scipy.optimize.least_squares to its own end; returns its final cost (chi square).

    sparse: by trf with the sparsity pattern of the Jacobian, stopped after PEER_EVALUATIONS; else by MINPACK's dense Levenberg-Marquardt.
    """
    from scipy.optimize import least_squares
    from scipy.sparse import lil_matrix

    layout, rows = lineariser.layout, lineariser.rows
    g, s = layout.size, len(rows.stations)
    at = system(lineariser, begin, NOISE, weights)
    count = at.X.shape[1]

    def residual(x: np.ndarray) -> np.ndarray:
        moved = begin.moved(layout, x[:g], x[g:].reshape(s, 6))
        _, r = lineariser.residual(moved)
        return at.whitening(rows.pad(r)[..., None]).reshape(-1)

    first = np.zeros(g + 6 * s)
    scale = np.concatenate([layout.gather("scale") * 0.01, np.tile([0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3], s)])
    if not sparse:
        return 2 * float(least_squares(residual, first, x_scale=scale, method="lm").cost)
    pattern = lil_matrix((len(residual(first)), g + 6 * s), dtype=int)
    pattern[:, :g] = 1
    for p, run in enumerate(rows.run):
        pattern[p * count : (p + 1) * count, g + 6 * run : g + 6 * run + 6] = 1
    found = least_squares(residual, first, jac_sparsity=pattern, x_scale=scale, method="trf", max_nfev=PEER_EVALUATIONS)
    return 2 * float(found.cost)


def recording(poses: int) -> Observations:
    """Observations of an arm with errors, eight balls a pose and eight poses a station."""
    rng = np.random.default_rng(0)
    times = max(poses // MADE_POSES, 1)
    made = scanner_cell(rng, stations=poses // times // 8)
    if times == 1:
        return made.observations
    one, count = made.observations, len(made.observations.cell.stations)
    stations = tuple(replace(s, id=f"{k}-{s.id}") for k in range(times) for s in one.cell.stations)
    truth = replace(made.truth, T_base_station=np.tile(made.truth.T_base_station, (times, 1, 1)))
    many = Observations(
        replace(one.cell, stations=stations),
        np.arange(times * one.n_poses),
        np.concatenate([one.station + k * count for k in range(times)]),
        np.tile(one.q, (times, 1)),
        np.concatenate([one.pose + k * one.n_poses for k in range(times)]),
        np.tile(one.ball, times),
        np.tile(one.xyz, (times, 1)),
    )
    return measure(many, truth, rng, NOISE.point, NOISE.joint[0])


def reflector() -> tuple[Observations, Chain, CellState]:
    """Readings of a reflector on the flange by a tracker, the nominal arm and the truth. The arm has no errors that pybotics has no
    parameter for (beta)."""
    rng = np.random.default_rng(0)
    cell = tracker_cell(rng, TRACKER_POSES)
    nominal, errors = cell.observations.cell.robot.chain, cell.errors * [1, 1, 1, 1, 0]
    truth = replace(cell.truth, chain=nominal.with_errors(errors))
    xyz = predict(cell.observations, truth).xyz + rng.normal(size=(TRACKER_POSES, 3)) * 0.02
    return replace(cell.observations, xyz=xyz), nominal, truth


def pybotics(interpreter: str) -> str:
    """Its fit of an arm to the readings, from the nominal arm. It is given the place of the base to a few millimetres and of the tool."""
    obs, nominal, truth = reflector()
    links = np.column_stack([np.r_[0.0, nominal.alpha[:-1]], np.r_[0.0, nominal.a[:-1]], nominal.theta, nominal.d])
    free = np.ones(links.shape, bool)
    free[0], free[1, 3] = False, False  # the base's own place; d of the first of two parallel axes
    end = np.eye(4)
    end[:3, :3] = se3.rotation_exp(np.array([nominal.alpha[-1], 0.0, 0.0]))
    tool = end @ np.r_[truth.T_flange_scanner[:3, 3], 1.0]
    base = se3.inverse(truth.T_base_station[0])
    world = np.r_[base[:3, 3] + [3.0, -2.0, 4.0], _zyx(base[:3, :3])]
    given = {"links": links, "free": free, "tool": np.r_[tool[:3], 0, 0, 0], "world": world}
    found = _fit_by(interpreter, "pybotics", q=obs.q * nominal.sign, xyz=obs.xyz, **given)
    return f"pybotics: {_said(found)}"


def figaroh(interpreter: str) -> str:
    """Its fits of the arm to the same readings, from the nominal arm and its own guess of the base and the tool."""
    obs, nominal, _ = reflector()
    turn = se3.exp(np.concatenate([np.zeros((nominal.n, 5)), nominal.theta[:, None]], axis=1))
    links = replace(nominal, theta=np.zeros(nominal.n)).link_transforms(np.zeros((1, nominal.n)))[0]
    placements = np.concatenate([turn[:1], links[:-1] @ turn[1:], links[-1:]])
    found = _fit_by(interpreter, "figaroh", q=obs.q * nominal.sign, xyz=obs.xyz, placements=placements)
    return "; ".join(f"FIGAROH, {method}, {one['parameters']} parameters: {_said(one)}" for method, one in found.items())


def _fit_by(interpreter: str, peer: str, **given: np.ndarray) -> dict:
    """What ``peer_fits.py`` prints of these arrays."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.npz"
        np.savez(file, **given)
        command = [interpreter, str(HERE / "peer_fits.py"), peer, str(file)]
        return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def _said(found: dict) -> str:
    return f"{1e3 * found['seconds']:.0f} ms, rms {found['rms_mm']:.4f} mm after {found['evaluations']} evaluations"


def _zyx(R: np.ndarray) -> list[float]:
    """The three angles by which pybotics writes a rotation: R = Rz(a) Ry(b) Rx(c)."""
    return [float(np.arctan2(R[1, 0], R[0, 0])), float(-np.arcsin(R[2, 0])), float(np.arctan2(R[2, 1], R[2, 2]))]


def calibration(given: argparse.Namespace) -> None:
    """Time to calibrate, against the number of poses, and beside scipy's sparse least squares on the same problem from the same start.

    Prints a Markdown table. The peer gets everything for nothing: start, noise, and the true sparsity pattern of its Jacobian (arm
    and hand-eye dense, each station's six columns only where it is seen); it minimises the same whitened residuals with numerical
    derivatives. --pybotics, --figaroh: they fit the arm to 104 readings of a reflector by a tracker, and so does ``calibrate``.
    """
    print(f"<!-- {machine()} -->")
    print("| poses | stations | calibrate ms | adjustment alone ms | scipy ms, sparse and dense | scipy over calibrate | peak memory MB |")
    print("|--:|--:|--:|--:|--:|--:|--:|")
    for poses in given.poses:
        obs = recording(poses)
        repeats = max(min(given.repeats, 30000 // poses), 3)
        whole = best(lambda obs=obs: calibrate(obs), repeats)
        options = CalibrationOptions(balls=False)
        lineariser = Lineariser(obs, parameters.build(obs, options), options)
        begin, weights = Estimate(start(obs)), Weights(np.ones(obs.n_centres), np.ones(obs.n_poses))
        alone = best(lambda a=lineariser, b=begin, w=weights: solve(a, b, NOISE, w), repeats)
        other = ratio = "-"
        if not given.no_peer and poses <= PEER_POSES:
            ours = solve(lineariser, begin, NOISE, weights).cost
            scipy_ms = []
            for sparse in (True, False):
                clock = time.process_time()
                theirs = peer(lineariser, begin, weights, sparse)
                scipy_ms.append(1e3 * (time.process_time() - clock))
                print(f"<!-- {poses} poses: scipy ended at chi square {theirs:.1f}, we at {ours:.1f} -->")
            other, ratio = (", ".join(f"{one:.0f}" for one in each) for each in (scipy_ms, np.array(scipy_ms) / whole))
        tracemalloc.start()
        calibrate(obs)
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        print(f"| {poses} | {len(obs.cell.stations)} | {whole:.0f} | {alone:.0f} | {other} | {ratio} | {peak:.0f} |", flush=True)
    if given.pybotics or given.figaroh:
        obs = reflector()[0]
        own = best(lambda: calibrate(obs), given.repeats)
        print(f"{TRACKER_POSES} readings of a reflector: calibrate {own:.0f} ms, rms {calibrate(obs).fit.rms_mm:.4f} mm")
    if given.pybotics:
        print(pybotics(given.pybotics))
    if given.figaroh:
        print(figaroh(given.figaroh))


LIMIT = np.radians(65.0)
VIEW = np.array([0.0, 0.0, 1.0])


def scene(spacing: float):
    artefact = clouds.artefact()
    centres = artefact.centres @ clouds.rotation([1, 2, 0.5], 18).T + [3, -4, 5]
    return artefact, centres, clouds.scan(np.random.default_rng(0), centres, artefact.diameters, spacing=spacing)


def best_of(call, runs: int):
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    return float(np.median(times)), result


def open3d_and_scipy(points: np.ndarray, radius: float) -> np.ndarray:
    """The usual recipe: take the largest plane away, cluster the rest, fit each cluster robustly with the known radius."""
    from scipy.optimize import least_squares

    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(float)))
    _, plane = cloud.segment_plane(0.1, 3, 200)
    cloud = cloud.select_by_index(plane, invert=True)
    label = np.array(cloud.cluster_dbscan(eps=0.8, min_points=8))
    rest, centres = np.asarray(cloud.points), []
    for k in range(label.max() + 1):
        mine = rest[label == k]
        if len(mine) < 300:
            continue
        start = mine.mean(axis=0) - [0, 0, 0.7 * radius]
        fit = least_squares(lambda c, p=mine: np.linalg.norm(p - c, axis=1) - radius, start, loss="soft_l1", f_scale=0.02)
        centres.append(fit.x)
    return np.array(centres)


def timing(runs: int) -> list[dict]:
    rows = []
    for spacing, with_peer in ((0.25, True), (0.17, True), (0.084, False)):
        artefact, centres, points = scene(spacing)
        find_spheres(points, artefact)
        ours, found = best_of(lambda p=points, a=artefact: find_spheres(p, a), runs)
        worst = 1e3 * float(np.abs(found.xyz - centres).max())
        row = {"points": len(points), "balls": len(found), "ours_ms": 1e3 * ours, "ours_worst_um": worst}
        if with_peer:
            peer, other = best_of(lambda p=points: open3d_and_scipy(p, 6.0), 3)
            nearest = np.abs(other[np.argmin(np.linalg.norm(other[None] - centres[:, None], axis=2), axis=1)] - centres)
            row |= {"peer_ms": 1e3 * peer, "peer_worst_um": 1e3 * float(nearest.max()), "ratio": peer / ours}
        rows.append(row)
    return rows


def accuracy(runs: int, n: int = 1500, noise: float = 0.01, outliers: float = 0.03) -> dict:
    """Scatter and bias of one fitted centre over the bound, for n points of which a share are one-sided rim outliers."""
    from scipy.optimize import least_squares

    rng = np.random.default_rng(1)
    truth = rng.uniform(-30, 30, (runs, 3))
    points = [clouds.cap(rng, c, 12.0, n, noise=noise, outliers=outliers) for c in truth]
    start = truth + rng.normal(0, 0.2, truth.shape)
    radii = np.full(runs, 6.0)
    begin = time.perf_counter()
    fits = sphere_fits(points, rough_fits(points, start, radii, 0.08), radii, VIEW, LIMIT, 0.08)
    ours_s = (time.perf_counter() - begin) / runs
    begin = time.perf_counter()
    peers = [
        least_squares(lambda c, p=p: np.linalg.norm(p - c, axis=1) - 6.0, s, loss="soft_l1", f_scale=0.02).x
        for p, s in zip(points, start, strict=True)
    ]
    peer_s = (time.perf_counter() - begin) / runs
    used = n * (1 - outliers) * (np.sin(LIMIT) / np.sin(np.radians(75))) ** 2
    side = np.sin(LIMIT) ** 2 / 4
    bound = noise / np.sqrt(used * np.array([side, side, 1 - 2 * side]))
    out = {"runs": runs, "points": n, "noise_um": 1e3 * noise, "outliers": outliers, "bound_um": (1e3 * bound).tolist()}
    for name, centre, seconds in (("ours", np.array([f.centre for f in fits]), ours_s), ("scipy", np.array(peers), peer_s)):
        error = centre - truth
        out[name] = {
            "std_over_bound": (error.std(axis=0) / bound).tolist(),
            "bias_um": (1e3 * error.mean(axis=0)).tolist(),
            "bias_sigma_um": (1e3 * error.std(axis=0) / np.sqrt(runs)).tolist(),
            "ms_per_ball": 1e3 * seconds,
        }
    return out


def spheres(given: argparse.Namespace) -> None:
    """Ball extraction: time for frames up to two megapixels, and accuracy against the Cramer-Rao bound, with peers in the same run.

    Ratios to the peers matter more than the times, which depend on the machine.
    """
    result = {"timing": timing(given.runs), "accuracy": accuracy(400)}
    if given.json:
        print(json.dumps(result, indent=1))
        return
    for row in result["timing"]:
        print(f"{row['points']:8d} points, {row['balls']} balls: {row['ours_ms']:.1f} ms, worst coordinate {row['ours_worst_um']:.2f} um")
        if "peer_ms" in row:
            print(f"{'Open3D + SciPy':>24s}: {row['peer_ms']:.0f} ms ({row['ratio']:.1f} x), worst {row['peer_worst_um']:.2f} um")
    a = result["accuracy"]
    print(f"one ball, {a['points']} points, {a['noise_um']:.0f} um noise, {a['outliers']:.0%} rim outliers, {a['runs']} draws:")
    for name in ("ours", "scipy"):
        r = a[name]
        scatter, bias = (" ".join(f"{v:+.3f}" for v in r[key]) for key in ("std_over_bound", "bias_um"))
        print(f"  {name:6s} scatter / bound {scatter}   bias um {bias} (+-{r['bias_sigma_um'][2]:.3f})   {r['ms_per_ball']:.2f} ms a ball")


ARMS = ("ur10", "ur10e", "crx10ia", "panda", "iiwa14", "kr10_r1100_2")
BRANCH_POSES = 500
AGREE = 1e-4  # rad


def robot(name: str) -> RobotModel:
    return RobotSpec.model_validate(yaml.safe_load(shipped.robot_file(name).read_text(encoding="utf-8"))).model()


def ur_branches(arm: RobotModel, T: np.ndarray) -> np.ndarray:
    """Every joint position (k, 6) rad in (-pi, pi] of a UR at a flange pose (4, 4): two shoulders, two wrists, two elbows.

    Axes 2, 3 and 4 are parallel: the arm's plane, turned by q1, passes the wrist at the distance d4; in it lies a two-link arm.
    """
    d1, d4, d5, d6 = arm.chain.d[[0, 3, 4, 5]]
    a2, a3 = arm.chain.a[[1, 2]]
    p5 = T[:3, 3] - d6 * T[:3, 2]
    out, across = [], np.hypot(p5[0], p5[1])
    if across < abs(d4):
        return np.empty((0, 6))
    for q1 in np.arctan2(p5[1], p5[0]) + np.pi / 2 + np.array([1, -1]) * np.arccos(d4 / across):
        side = np.array([np.sin(q1), -np.cos(q1), 0.0])
        cosine = (T[:3, 3] @ side - d4) / d6
        if abs(cosine) > 1:
            continue
        for q5 in np.array([1, -1]) * np.arccos(cosine):
            x, y = T[:3, 0] @ side, T[:3, 1] @ side
            q6 = np.arctan2(-y / np.sin(q5), x / np.sin(q5))
            # What is left, from axis 2 to the wrist, lies in the plane of the two links.
            chain = arm.chain.link_transforms(np.array([[q1, 0, 0, 0, q5, q6]]))[0]
            M = np.linalg.inv(chain[0]) @ T @ np.linalg.inv(chain[4] @ chain[5])
            u, v = M[0, 3], M[1, 3]
            bend = (u * u + v * v - a2 * a2 - a3 * a3) / (2 * a2 * a3)
            if abs(bend) > 1:
                continue
            for q3 in np.array([1, -1]) * np.arccos(bend):
                q2 = np.arctan2(v, u) - np.arctan2(a3 * np.sin(q3), a2 + a3 * np.cos(q3))
                q4 = np.arctan2(M[1, 0], M[0, 0]) - q2 - q3
                out.append([q1, q2, q3, q4, q5, q6])
    return np.pi - np.mod(np.pi - np.array(out).reshape(-1, 6), 2 * np.pi)


def missed(known: np.ndarray, found: np.ndarray) -> int:
    """How many of the known positions (k, n) are not among those found, full turns apart."""
    away = np.abs(np.mod(known[:, None] - found[None] + np.pi, 2 * np.pi) - np.pi).max(axis=2)
    return int((away.min(axis=1, initial=np.inf) > AGREE).sum())


def branches_found(name: str, poses: int) -> tuple[int, int, int]:
    """Branches that exist, that were missed, and targets of which one was missed."""
    arm = robot(name)
    q = np.random.default_rng(11).uniform(-np.pi, np.pi, (poses, 6))
    q = np.clip(q, arm.limits[:, 0], arm.limits[:, 1])
    T = arm.chain.flange(q)
    found = NumericalInverse(arm.chain, arm.limits).branches(T)
    if name.startswith("ur"):
        known = [ur_branches(arm, t) for t in T]
        assert all(np.abs(arm.chain.flange(k) - t).max() < 1e-6 for k, t in zip(known, T, strict=True))
    else:
        known = OrthoParallelInverse.of(arm).solutions(T)
    lost = [missed(k, f) for k, f in zip(known, found, strict=True)]
    unique = [len(np.unique(np.mod(k.round(6), 2 * np.pi).round(5), axis=0)) for k in known]
    return sum(unique), sum(lost), sum(1 for n in lost if n)


def solved(name: str, poses: int) -> tuple[int, float, float]:
    """Targets without a solution, ms a target, largest miss of a solution (mm)."""
    arm = robot(name)
    q = np.random.default_rng(5).uniform(arm.limits[:, 0], arm.limits[:, 1], (poses, arm.n))
    T = arm.chain.flange(q)
    solver = NumericalInverse(arm.chain, arm.limits)
    solver.branches(T[:1])  # its table of starts
    start, left, miss = time.perf_counter(), 0, 0.0
    for first in range(0, poses, 200):
        for found, target in zip(solver.branches(T[first : first + 200]), T[first : first + 200], strict=True):
            left += not len(found)
            inside = (found >= arm.limits[:, 0]) & (found <= arm.limits[:, 1])
            assert inside.all(), name
            miss = max(miss, float(np.abs(arm.chain.flange(found) - target)[:, :3, 3].max(initial=0.0)))
    return left, 1e3 * (time.perf_counter() - start) / poses, miss


def inverse_kinematics(given: argparse.Namespace) -> None:
    """How much of its reach the numerical inverse kinematics finds, and whether it finds every branch.

    Poses are those of random joint angles within the limits, so every one can be reached. The branches of the UR10 are compared with
    a closed form written here from the arm's geometry, those of the KR 10 R1100-2 with py-opw-kinematics.
    """
    lines = ["# Numerical inverse kinematics", ""]
    lines += [f"Random reachable poses, {given.poses} an arm. Made by `python benchmarks/speed.py inverse-kinematics {given.poses}`.", ""]
    lines += ["| arm | axes | solved | without a solution | largest miss, mm | ms a pose |", "|---|---|---|---|---|---|"]
    for name in ARMS:
        left, ms, miss = solved(name, given.poses)
        lines.append(
            f"| {name} | {robot(name).n} | {100 * (1 - left / given.poses):.2f} % | {left} of {given.poses} | {miss:.1e} | {ms:.0f} |"
        )
        print(lines[-1], flush=True)
    lines += ["", f"Branches against a closed form, {BRANCH_POSES} poses an arm.", ""]
    lines += ["| arm | branches that exist | missed | poses with all of them |", "|---|---|---|---|"]
    for name in ("ur10", "ur10e", "kr10_r1100_2"):
        exist, lost, targets = branches_found(name, BRANCH_POSES)
        lines.append(f"| {name} | {exist} | {lost} | {100 * (1 - targets / BRANCH_POSES):.1f} % |")
        print(lines[-1], flush=True)
    given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    SIZES = option("--poses", type=int, nargs="+", default=[104, 304, 1000, 3000, 10000, 30000, 100000])
    PEERS = [
        option("--no-peer", action="store_true"),
        option("--pybotics", metavar="PYTHON", help="an interpreter that has pybotics"),
        option("--figaroh", metavar="PYTHON", help="an interpreter that has FIGAROH"),
    ]
    PAGE = option("--out", type=Path, default=HERE / "inverse_kinematics.md")
    bench.main(
        __doc__,
        {
            "calibration": (calibration, [SIZES, option("--repeats", type=int, default=7), *PEERS]),
            "spheres": (spheres, [option("--json", action="store_true"), option("--runs", type=int, default=9)]),
            "inverse-kinematics": (inverse_kinematics, [option("poses", type=int, nargs="?", default=2000), PAGE]),
        },
    )
