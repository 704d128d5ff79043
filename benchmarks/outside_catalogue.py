"""Cells whose physics no effect of the catalogue describes: a wrong name that is called an explanation, and where the mismatch is found.

OMP_NUM_THREADS=1 python benchmarks/outside_catalogue.py score --cells 25 --write     300 cells, an hour on one core
OMP_NUM_THREADS=1 python benchmarks/outside_catalogue.py score --only two_angles --first 1000
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from typing import Any

import bench
import numpy as np
from bench import HERE, Kept, keeps, option, put, table, writes
from outside.physics import KINDS, run
from statements import contradictions

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.findings import LOOK_AT
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.effect_term import UNKNOWN

PAGE = HERE / "outside_catalogue.md"
VERDICTS = ("cannot_tell", "none")  # shown beside names and locations


def outcome(kind: str, seed: int) -> dict[str, Any]:
    """One cell, diagnosed."""
    number = list(KINDS).index(kind)
    world = run(1000 * number + seed)
    size = float(np.exp(world.rng.uniform(np.log(0.7), np.log(2.0))))
    there = KINDS[kind].displace(world, size)
    obs, begun = world.measured(), time.process_time()
    found = diagnose(obs)
    return {"kind": kind, "seed": seed, "size": size, "there": there, "seconds": time.process_time() - begun} | judged(kind, there, found)


def judged(kind: str, there: tuple[str, ...], found: Diagnosis) -> dict[str, Any]:
    """What was said: whether a wrong name is called an explanation, and whether the largest mismatch is at one of the right locations."""
    named = frozenset(e.name for e in found.effects if e.name != UNKNOWN)
    first = found.mismatch[0] if found.mismatch else None
    at = () if first is None else (first.at, *first.equivalent)
    at += tuple(f"ball{one.reason.removeprefix(LOOK_AT).split()[0]}" for one in found.rejected_balls)
    return {
        "verdict": found.verdict,
        "said": [f"{e.name}:{'+'.join(e.where)} by {e.depends_on}" for e in found.effects],
        "wrong": found.verdict == "explained" and bool(named) and named not in KINDS[kind].right,
        "right": found.verdict == "explained" and named in KINDS[kind].right,
        "located": bool(set(at) & set(there)),
        "at": at,
        "chi2": found.fit.held_out.after_chi2_dof,
        "contradictions": contradictions(found),
    }


def score(given: argparse.Namespace) -> None:
    """Twelve kinds of physics that the catalogue lacks, or has in another form: verdicts, wrong names, locations."""
    kept = Kept(given.kept)
    done = {(row["kind"], row["seed"]) for row in kept.rows}
    for seed in range(given.first, given.first + given.cells):
        for kind in given.only or KINDS:
            if (kind, seed) not in done:
                row = outcome(kind, seed)
                kept.add(row)
                mark = "WRONG" if row["wrong"] else "elsewhere" if not row["located"] else ""
                print(f"{kind} {seed} {row['size']:.2f} {row['there']} {row['verdict']} {row['said']} {row['at'][:2]} {row['chi2']:.2f} "
                      f"{row['seconds']:.0f} s {mark}", flush=True)  # fmt: skip
    if given.write:
        put(PAGE, "\n".join(lines(kept.rows)))


def lines(rows: list[dict[str, Any]]) -> list[str]:
    """The table of the page, and the cells with a wrong name."""
    each = []
    for kind in KINDS:
        mine = [row for row in rows if row["kind"] == kind]
        counts = Counter(row["verdict"] for row in mine)
        if mine:
            sums = [sum(row[key] for row in mine) or "" for key in ("right", "wrong", "located")]
            each.append([kind, len(mine), *sums, *(counts[verdict] or "" for verdict in VERDICTS)])
    total = len(rows), *(sum(row[key] for row in rows) for key in ("right", "wrong", "located"))
    wrong = [f"- {row['kind']} {row['seed']}, size {row['size']:.1f}: {'; '.join(row['said'])}" for row in rows if row["wrong"]]
    said = [f"- {row['kind']} {row['seed']}: {one}" for row in rows for one in row["contradictions"]]
    heads = ["kind", "cells", "explained by a right name", "by a wrong name", "location right", *VERDICTS]
    sums = ["all", *total, *("" for _ in VERDICTS)]
    lists = {"Explained by a wrong name:": wrong, "Statements that contradict each other:": said}
    return [*table(heads, [*each, sums]), *(line for head, some in lists.items() for line in ("", head, "", *(some or ["none"])))]


if __name__ == "__main__":
    CELLS = [option("--cells", type=int, default=25, help="of each kind"), option("--first", type=int, default=0, help="first seed")]
    KINDS_ASKED = option("--only", action="append", choices=list(KINDS), help="these kinds alone")
    bench.main(
        __doc__, {"score": (score, [*CELLS, KINDS_ASKED, keeps("outside_catalogue.jsonl"), writes("benchmarks/outside_catalogue.md")])}
    )
