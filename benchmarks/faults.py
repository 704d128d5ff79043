"""Faults from outside: while a run goes on, in its middle or in that of another command, and at every message of every device.

    python benchmarks/faults.py system-calls [--cases 200] [--seed 0] [--only CALL ...] [--cycle] [--clock] [--kept FILE]
    python benchmarks/faults.py ctrl-c [--cases 60] [--seed 0] [--minutes M]
    unshare -m sh -c "mount -t tmpfs tmpfs /dev/shm; exec python benchmarks/faults.py ctrl-c"     # shared memory of nobody else
    python benchmarks/faults.py soak [--minutes 120] [--seed 0] [--chart soak.svg]
    python benchmarks/faults.py kills [--rounds 50] [--seed 1]
    python benchmarks/faults.py power-cuts [--moments 60] [--seed 0] [--resume-every 10]
    python benchmarks/faults.py flipped-bits [--flips 2000] [--seed 0] [--minutes M]
    python benchmarks/faults.py commands [--moments 400] [--seed 0] [--only correct apply] [--kept FILE] [--write]
    python benchmarks/faults.py messages [--only NAME ...] [--most N] [--json FILE]
    python benchmarks/faults.py messages --only "whole run over EKI, GoPxL, Modbus, serial" --draw 60 --seed 1

Each command says more with --help.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bench
from bench import option
from faults.commands import commands
from faults.ctrl_c import ctrl_c
from faults.flipped_bits import flipped_bits
from faults.kills import kills
from faults.messages import NAMES, messages
from faults.power_cuts import power_cuts
from faults.soak import soak
from faults.system_calls import ERRNOS, system_calls

if __name__ == "__main__":
    SEED = option("--seed", type=int, default=0)
    MINUTES = option("--minutes", type=float, default=1e9, help="begin no further case after this time")
    CASES = [option("--cases", type=int, default=200), option("--only", nargs="+", choices=list(ERRNOS), default=list(ERRNOS))]
    KINDS = [option("--cycle", action="store_true"), option("--clock", action="store_true"), option("--kept", type=Path)]
    HOURS = [option("--minutes", type=float, default=120.0), SEED, option("--chart", type=Path, default=Path("soak.svg"))]
    CUTS = [option("--moments", type=int, default=60), SEED, option("--resume-every", type=int, default=10)]
    STRUCK = [
        option("--moments", type=int, default=400, help="of each command that replaces, at which it is struck in the replay"),
        option("--only", nargs="+", metavar="COMMAND", help="names of commands"),
        option("--kept", type=Path, help="outcomes are added to this file at once; what is in it is not repeated"),
        option("--write", action="store_true", help="put the rows of the commands that were struck into the page; the others stay"),
    ]
    HURT = [
        option("--only", nargs="+", choices=NAMES, default=NAMES, metavar="NAME"),
        option("--most", type=int, default=12, help="messages of each link and sender that are hurt (default 12)"),
        option("--draw", type=int, default=0, help="instead, so many faults at messages drawn at random"),
        option("--flip", action="store_true", help="flip one bit of a message, and do nothing else to it"),
        option("--json", type=Path, help="write every verdict here"),
    ]
    sys.exit(
        bench.main(
            __doc__,
            {
                "system-calls": (system_calls, [*CASES, *KINDS, SEED, MINUTES]),
                "ctrl-c": (ctrl_c, [option("--cases", type=int, default=60), SEED, MINUTES]),
                "soak": (soak, HOURS),
                "kills": (kills, [option("--rounds", type=int, default=50), option("--seed", type=int, default=1)]),
                "power-cuts": (power_cuts, CUTS),
                "flipped-bits": (flipped_bits, [option("--flips", type=int, default=2000), SEED, MINUTES]),
                "commands": (commands, [*STRUCK, SEED]),
                "messages": (messages, [*HURT, SEED]),
            },
        )
    )
