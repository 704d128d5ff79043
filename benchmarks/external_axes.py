"""Cells with a track, a positioner, a gantry and a stroke: is the error of the links as large as stated?

    python benchmarks/external_axes.py [--seeds 30]

The normalised error squared (NEES) is d' inv(C) d over the number of links' parameters; the truth and the cells are those of the tests.
"""

from __future__ import annotations

import argparse

import bench  # noqa: F401  # the simulated cells of the tests
import joint_cells as made
import numpy as np
from test_joint_cells import FREE, along_a_track, by_a_tracker, on_a_table, under_a_gantry

from mbcacq.calibration.calibrate import calibrate

CELLS = {
    "KR 10 class arm on a track of 4 m": along_a_track,
    "the same before a two-axis positioner": on_a_table,
    "gantry with a wrist": under_a_gantry,
    "SCARA, by a tracker": by_a_tracker,
}


def main(seeds: int) -> None:
    print("| cell | cells | parameters of the links | NEES | error over stated, rms |\n|---|--:|--:|--:|--:|")
    for name, make in CELLS.items():
        squares, total = [], 0.0
        for seed in range(100, 100 + seeds):
            truth = make(np.random.default_rng(seed))
            error, covariance = made.arm_error(found := calibrate(truth.observations, FREE), truth)
            scale = np.sqrt(np.diag(covariance))
            squares += ((error / scale) ** 2).tolist()
            total += (error / scale) @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale)
        free, count = int(found.layout.blocks[0].free.sum()), len(squares)
        print(
            f"| {name} | {seeds} | {free} | {total / count:.2f} ± {np.sqrt(2 / count):.2f} | {np.sqrt(np.mean(squares)):.2f} |", flush=True
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    main(parser.parse_args().seeds)
