"""How long calibration, ball extraction, inverse kinematics and the decoding of scans take, with peers in the same run; how exact they are.

    python benchmarks/speed.py calibration [--poses 104 304 1000 3000] [--repeats 7] [--no-peer] [--pybotics PYTHON] [--figaroh PYTHON]
    python benchmarks/speed.py spheres [--json]
    python benchmarks/speed.py inverse-kinematics [POSES]
    python benchmarks/speed.py gocator [REPETITIONS] [--write]

Each command says more with --help.
"""

from __future__ import annotations

from pathlib import Path

import bench
from bench import HERE, option, writes
from speed.calibration import calibration
from speed.gocator import gocator
from speed.inverse_kinematics import inverse_kinematics
from speed.spheres import spheres

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
            "gocator": (gocator, [option("repetitions", type=int, nargs="?", default=41), writes("benchmarks/gocator_decode.md")]),
        },
    )
