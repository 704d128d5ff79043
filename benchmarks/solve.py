"""Time to calibrate, against the number of poses, and beside scipy's sparse least squares on the same problem from the same start.

    python benchmarks/solve.py [--poses 100 300 1000 3000] [--repeats 7] [--no-peer]

Prints a Markdown table. The peer gets everything for nothing: start, noise, and the true sparsity pattern of its Jacobian (arm and hand-eye
dense, each station's six columns only where it is seen); it minimises the same whitened residuals with numerical derivatives.
"""

from __future__ import annotations

import argparse
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "calibration"))
from cells import scanner_cell  # noqa: E402

from mbcacq.calibration import CalibrationOptions, Noise, calibrate
from mbcacq.estimation import parameters  # noqa: E402
from mbcacq.estimation.initial_guess import start  # noqa: E402
from mbcacq.estimation.linearization import Lineariser  # noqa: E402
from mbcacq.estimation.parameters import Estimate  # noqa: E402
from mbcacq.estimation.solver import Weights, solve, system  # noqa: E402

PEER_POSES, PEER_EVALUATIONS = 120, 8
NOISE = Noise(np.array([0.005, 0.005, 0.009]), np.full(6, 8e-6))


def best(function, repeats: int) -> tuple[float, float, float]:
    """Smallest and median wall time, and smallest processor time, in s."""
    times, own = [], []
    for _ in range(repeats):
        begin, used = time.perf_counter(), time.process_time()
        function()
        times.append(time.perf_counter() - begin)
        own.append(time.process_time() - used)
    return min(times), float(np.median(times)), min(own)


def peer(lineariser: Lineariser, begin: Estimate, weights: Weights) -> float:
    """One run of scipy.optimize.least_squares; returns its final cost (chi square)."""
    from scipy.optimize import least_squares
    from scipy.sparse import lil_matrix

    layout, rows = lineariser.layout, lineariser.rows
    g, s = layout.size, len(rows.stations)
    at = system(lineariser, begin, NOISE, weights)
    count = at.X.shape[1]

    def residual(x):
        moved = begin.moved(layout, x[:g], x[g:].reshape(s, 6))
        _, r = lineariser.residual(moved)
        return at.whitening(rows.pad(r)[..., None]).reshape(-1)

    pattern = lil_matrix((len(residual(np.zeros(g + 6 * s))), g + 6 * s), dtype=int)
    pattern[:, :g] = 1
    for p, run in enumerate(rows.run):
        pattern[p * count : (p + 1) * count, g + 6 * run : g + 6 * run + 6] = 1
    scale = np.concatenate([layout.gather("scale") * 0.01, np.tile([0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3], s)])
    found = least_squares(residual, np.zeros(g + 6 * s), jac_sparsity=pattern, x_scale=scale, method="trf", max_nfev=PEER_EVALUATIONS)
    return 2 * float(found.cost)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--poses", type=int, nargs="+", default=[104, 304, 1000, 3000])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--no-peer", action="store_true")
    arguments = parser.parse_args()
    print("| poses | stations | calibrate: best / median ms | processor ms | adjustment alone: ms | scipy ms | ratio | peak memory MB |")
    print("|---|---|---|---|---|---|---|---|")
    for poses in arguments.poses:
        obs = scanner_cell(np.random.default_rng(0), stations=poses // 8).observations
        low, middle, own = best(lambda obs=obs: calibrate(obs), arguments.repeats)
        options = CalibrationOptions(balls=False)
        lineariser = Lineariser(obs, parameters.build(obs, options), options)
        begin, weights = Estimate(start(obs)), Weights(np.ones(obs.n_centres), np.ones(obs.n_poses))
        alone, *_ = best(lambda a=lineariser, b=begin, w=weights: solve(a, b, NOISE, w), arguments.repeats)
        other = ratio = "-"
        if not arguments.no_peer and poses <= PEER_POSES:
            ours = solve(lineariser, begin, NOISE, weights).cost
            clock = time.perf_counter()
            theirs = peer(lineariser, begin, weights)
            scipy_time = time.perf_counter() - clock
            if abs(theirs - ours) > 1e-3 * ours:
                print(f"<!-- {poses} poses: scipy ended at chi square {theirs:.1f}, we at {ours:.1f} -->")
            other, ratio = f"{1e3 * scipy_time:.0f}", f"{scipy_time / alone:.0f}"
        tracemalloc.start()
        calibrate(obs)
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        print(
            f"| {poses} | {poses // 8} | {1e3 * low:.0f} / {1e3 * middle:.0f} | {1e3 * own:.0f} | {1e3 * alone:.0f} | "
            f"{other} | {ratio} | {peak:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
