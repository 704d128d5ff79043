"""What a diagnosis finds, by the size, instrument and noise statement of a recording; what it says of the rest, against the truth.

    OMP_NUM_THREADS=1 python benchmarks/detection.py sizes                 200 cells a row, half as many with an effect (four hours)
    OMP_NUM_THREADS=1 python benchmarks/detection.py sizes --minutes 4     go on for so long: every row grows evenly
    OMP_NUM_THREADS=1 python benchmarks/detection.py sizes --cells 12 --poses 20 28 --instruments tracker artefact
    OMP_NUM_THREADS=1 python benchmarks/detection.py ball-shift
    OMP_NUM_THREADS=1 python benchmarks/detection.py exclusion --write
    OMP_NUM_THREADS=1 python benchmarks/detection.py exclusion --plans seeing --draws 10
    OMP_NUM_THREADS=1 python benchmarks/detection.py slow-gears --write
    OMP_NUM_THREADS=1 python benchmarks/detection.py slow-gears --plans seeing --cells 4

Each command says more with --help.
"""

from __future__ import annotations

from math import inf
from pathlib import Path

import bench
from bench import HERE, keeps, option, writes
from detection.ball_shift import ball_shift
from detection.exclusion import NAMES, exclusion
from detection.recording_sizes import INSTRUMENTS, POSES, STATED, sizes
from detection.slow_gears import slow_gears

if __name__ == "__main__":
    PLANS_ASKED = option("--plans", nargs="*", default=NAMES, choices=NAMES)
    DRAWS = [option("--draws", type=int, default=400), option("--first", type=int, default=1, help="seed of the first draw")]
    CELLS = [option("--cells", type=int, default=24), option("--first", type=int, default=1)]
    bench.main(
        __doc__,
        {
            "sizes": (
                sizes,
                [
                    option("--cells", type=int, default=200, help="with nothing injected, and half as many with an effect"),
                    option("--first", type=int, default=0, help="number of the first cell of each row: other numbers are other cells"),
                    option("--poses", type=int, nargs="*", default=POSES),
                    option("--instruments", nargs="*", choices=INSTRUMENTS, default=INSTRUMENTS),
                    option("--stated", type=float, nargs="*", default=STATED),
                    option("--minutes", type=float, default=inf, help="stop after so many"),
                    option("--kept", type=Path, nargs="*", default=[HERE / "recording_sizes.jsonl"], help="go on with the first, read all"),
                    option("--out", type=Path, default=HERE / "recording_sizes.md"),
                ],
            ),
            "ball-shift": (ball_shift, [option("--out", type=Path, default=HERE / "ball_shift.md")]),
            "exclusion": (exclusion, [PLANS_ASKED, *DRAWS, keeps("exclusion_limits.jsonl"), writes("benchmarks/exclusion_limits.md")]),
            "slow-gears": (slow_gears, [PLANS_ASKED, *CELLS, keeps("slow_gear_errors.jsonl"), writes("benchmarks/slow_gear_errors.md")]),
        },
    )
