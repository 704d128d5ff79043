"""Concealed cells investigated blind through the array path: poses and moves to the verdict, against the fixed plan; false alarms of looks.

    python benchmarks/investigate.py cells --count 200 --seed 1100      # four of ten of the catalogue, two outside, a pair, three clean
    python benchmarks/investigate.py protocols --count 20 --seed 1100   # every ninth of them through the fakes of robot and scanner
    python benchmarks/investigate.py looks --count 1000 --seed 1200     # clean cells, every instrument in turn, ten looks each: e-values
    python benchmarks/investigate.py page --seed 1100                   # the tables of benchmarks/investigate.md
    python benchmarks/investigate.py kills --count 20                   # kill -9 after a random pose, then resumed: is all as undisturbed?
    python benchmarks/investigate.py advice --count 50                  # diagnoses that cannot tell: does their advice decide?
    python benchmarks/investigate.py plan-order OLD.yaml NEW.yaml       # the first 64 poses of an ordered plan against all of another

Each command says more with --help. Nothing that is measured once is measured anew: a block adds its poses to those of the blocks before.
Every row is appended to a table in runs/investigate-benchmark, so that a call goes on where another ended.
"""

from __future__ import annotations

from pathlib import Path

import bench
from bench import option
from investigate.advice import advice
from investigate.cells import PLAN, cells, looks, page, protocols
from investigate.kills import kills
from investigate.plan_order import plan_order

if __name__ == "__main__":
    COUNT, SEED = option("--count", type=int, default=20), option("--seed", type=int, default=1100)
    FIRST = option("--first", type=int, default=0, help="number of the first cell; several calls may share a table")
    CANNOT_TELL = option("--count", type=int, default=50, help="diagnoses that cannot tell")
    TWO_PLANS = [option("old", type=Path, metavar="OLD.yaml"), option("new", type=Path, metavar="NEW.yaml")]
    OF_EACH = [option("--count", type=int, default=3, help="cells of each effect"), option("--seed", type=int, default=300)]
    bench.main(
        __doc__,
        {
            "cells": (cells, [COUNT, SEED, FIRST]),
            "protocols": (protocols, [COUNT, SEED]),
            "looks": (looks, [COUNT, SEED]),
            "page": (page, [SEED]),
            "kills": (kills, [COUNT, SEED]),
            "advice": (advice, [CANNOT_TELL, option("--seed", type=int, default=1300), option("--plan", type=Path, default=PLAN)]),
            "plan-order": (plan_order, [*TWO_PLANS, *OF_EACH, option("--in-time", action="store_true", help="only what acts in time")]),
        },
    )
