"""The published experiment, made again, and which left-out physics leaves its constant error.

    python benchmarks/paper.py experiment [--robot kr16_r2010_2] [--bar 1250] [--noise 1] [--seeds 20]
    python benchmarks/paper.py experiment --before          # what decides the error before calibration: noise, arm, bar
    python benchmarks/paper.py physics [--cells 12] [--out docs/paper-physics.svg] [--json FILE]

Each command says more with --help.
"""

from __future__ import annotations

from pathlib import Path

import bench
from bench import ROOT, option
from paper.experiment import experiment
from paper.physics import physics

if __name__ == "__main__":
    CELL = [
        option("--robot", default="kr16_r2010_2", help="a robot of plans/robots"),
        option("--noise", type=float, default=1.0, help="times 5, 5, 9 um a centre and RP = 0.04 mm"),
        option("--bar", type=float, default=1250.0, help="mm"),
    ]
    FIGURE = option("--out", type=Path, default=ROOT / "docs" / "paper-physics.svg")
    bench.main(
        __doc__,
        {
            "experiment": (experiment, [*CELL, option("--seeds", type=int, default=20), option("--before", action="store_true")]),
            "physics": (physics, [option("--cells", type=int, default=12), FIGURE, option("--json", type=Path)]),
        },
    )
