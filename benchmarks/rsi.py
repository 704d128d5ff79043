"""RSI over the wire: how soon a telegram is answered, and every set point that a controller is given.

    python benchmarks/rsi.py latency --write        three rounds of 60 s each, idle and under scan load: 18 minutes on a quiet machine
    python benchmarks/rsi.py latency --together --load compute memory       beside ten programs that compute, and ten that go through memory
    python benchmarks/rsi.py path [MOTIONS] [SEED]
    python benchmarks/rsi.py sequences [SEQUENCES] [SEED] [FIRST]     short ones, of every kind of disturbance, close together
    python benchmarks/rsi.py proof                  what the proof of an absolute correction costs before the first motion

Each command says more with --help.
"""

from __future__ import annotations

import sys

import bench
from bench import option, writes
from rsi.latency import LOADS, latency
from rsi.path import path, proof
from rsi.sequences import sequences

if __name__ == "__main__":
    MEASURED = [
        option("--seconds", type=int, default=60, help="of each program in each round"),
        option("--rounds", type=int, default=3),
        option("--load", nargs="+", choices=LOADS, default=["none", "scans"], help="what other programs do meanwhile"),
        option("--programs", type=int, default=10, help="how many of those that compute or go through memory"),
        option("--together", action="store_true", help="the C program and ours at once, asked in turn by one controller"),
    ]
    DRAWN = [option("motions", type=int, nargs="?", default=10_000), option("seed", type=int, nargs="?", default=1)]
    SHORT = [option("sequences", type=int, nargs="?", default=1_000_000), *DRAWN[1:]]
    SHORT += [option("first", type=int, nargs="?", default=0, help="number of the first session, to go on with an earlier call")]
    sys.exit(
        bench.main(
            __doc__,
            {
                "latency": (latency, [*MEASURED, writes("benchmarks/rsi_latency.md")]),
                "path": (path, DRAWN),
                "sequences": (sequences, SHORT),
                "proof": (proof, [option("--seeds", type=int, default=20)]),
            },
        )
    )
