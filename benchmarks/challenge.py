"""Effects injected in simulated cells and diagnosed without knowledge of them: the score table, and formulas for those outside it.

    OMP_NUM_THREADS=1 python benchmarks/challenge.py score                   everything, in two processes (hours)
    OMP_NUM_THREADS=1 python benchmarks/challenge.py score --share 0.3       a third of it
    OMP_NUM_THREADS=1 python benchmarks/challenge.py score --only clean      one part
    OMP_NUM_THREADS=1 python benchmarks/challenge.py formulas --write
    OMP_NUM_THREADS=1 python benchmarks/challenge.py formulas --only hose_twist

Each command says more with --help.
"""

from __future__ import annotations

from pathlib import Path

import bench
from bench import HERE, keeps, option, writes
from challenge.formulas import KINDS, SEEDS, formulas
from challenge.score import OTHERS, PARTS, score

if __name__ == "__main__":
    SHARE = option("--share", type=float, default=1.0, help="of the full number of challenges")
    PARTS_ASKED = option("--only", nargs="*", choices=[*PARTS, *OTHERS], default=[*PARTS, *OTHERS])
    JOBS, OUT = option("--jobs", type=int, default=2), option("--out", type=Path, default=HERE / "challenge.md")
    KINDS_ASKED = option("--only", action="append", choices=KINDS, help="these kinds alone")
    CELLS_ASKED = option("--seeds", type=int, default=len(SEEDS), help="cells of each kind")
    bench.main(
        __doc__,
        {
            "score": (score, [SHARE, PARTS_ASKED, JOBS, OUT, keeps("challenge.jsonl")]),
            "formulas": (formulas, [KINDS_ASKED, CELLS_ASKED, keeps("formulas.jsonl"), writes("benchmarks/formulas.md")]),
        },
    )
