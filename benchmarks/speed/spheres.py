"""Ball extraction beside Open3D with SciPy, and its scatter against the Cramér-Rao bound."""

from __future__ import annotations

import argparse
import json
import time

import clouds
import numpy as np

from mbcacq.files.open3d_library import open3d
from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.fit import rough_fits, sphere_fits

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
