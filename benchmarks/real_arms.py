"""Recordings of real arms, from outside: ladders of models, campaigns beside each other, what is learnt tried elsewhere, mistakes named.

    python benchmarks/real_arms.py ladder [SET ...] [--data ../shared/data] [--out docs/data]
    python benchmarks/real_arms.py campaigns
    python benchmarks/real_arms.py checks
    python benchmarks/real_arms.py transfer [--data ../shared/data] [--poses 1500] [--only ur10] [--write]
    python benchmarks/real_arms.py causes [--write]
    python benchmarks/real_arms.py compliance [--poses 1500] [--write]
    python benchmarks/real_arms.py found-again [SET ...] [--kept DIR] [--write]
    python benchmarks/real_arms.py wrong-descriptions > benchmarks/wrong_descriptions.md

Each command says more with --help.
"""

from __future__ import annotations

from pathlib import Path

import bench
from bench import DATA, option, writes
from real_arms.campaigns import campaigns
from real_arms.causes import causes
from real_arms.checks import checks
from real_arms.compliance import compliance
from real_arms.found_again import found_again
from real_arms.ladder import ladder
from real_arms.position_errors import SETS
from real_arms.transfer import transfer
from real_arms.wrong_descriptions import descriptions


def poses(most: int) -> bench.Option:
    return option("--poses", type=int, default=most, help="of each campaign, at random")


if __name__ == "__main__":
    OUT = option("--out", type=Path, default=Path("docs/data"))
    bench.main(
        __doc__,
        {
            "ladder": (ladder, [option("sets", nargs="*", default=SETS), DATA, OUT]),
            "campaigns": (campaigns, [DATA, OUT]),
            "checks": (checks, [DATA]),
            "transfer": (transfer, [DATA, poses(100_000), option("--only", choices=("ur5", "ur10")), writes("benchmarks/transfer.md")]),
            "causes": (causes, [DATA, poses(100_000), writes("benchmarks/transfer.md")]),
            "compliance": (compliance, [DATA, poses(1500), writes("docs/data/ur10-tracker.md")]),
            "found-again": (
                found_again,
                [
                    option("sets", nargs="*"),
                    DATA,
                    option("--kept", type=Path, default=Path("found-again"), help="folder of the diagnoses so far"),
                    writes("benchmarks/found_again.md"),
                ],
            ),
            "wrong-descriptions": (descriptions, [DATA]),
        },
    )
