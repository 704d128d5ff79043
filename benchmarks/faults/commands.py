"""Commands that are struck while they write."""

from __future__ import annotations

import argparse
import os
import random
import tempfile
from collections import Counter
from pathlib import Path

from bench import HERE, Kept, put, table

from faults.command_inputs import make_inputs, make_run
from faults.measured_checks import NAME as CHECK
from faults.measured_checks import MeasuredCheck
from faults.preloaded import preload
from faults.replaced_outputs import ReplacedOutputs
from faults.replacing_commands import cases
from faults.resumed_sessions import ResumedSession, sessions
from faults.strikes import Struck

PAGE = HERE / "interrupted_commands.md"
HEADS = ("command", "strike", "exit", "old", "new", "between", "neither")


def strike(struck: Struck, seed: int, kept: Kept) -> None:
    """Each strike that is not among the outcomes yet."""
    planned = struck.planned(random.Random(f"{seed} {struck.name}"))
    there = {(row["strike"], row["number"]) for row in kept.rows if (row["command"], row["seed"]) == (struck.name, seed)}
    for kind, number in planned:
        if (kind, number) in there:
            continue
        code, found = struck.strike(kind, number, random.Random(f"{seed} {struck.name} {kind} {number}"))
        kept.add({"command": struck.name, "seed": seed, "strike": kind, "number": number, "exit": code, "found": found})
        if not isinstance(struck, ReplacedOutputs) or found.startswith("neither"):
            print(f"  {struck.name}: {kind} at {number}, exit {code}: {found}", flush=True)


def rows_of(name: str, kept: Kept) -> list[list[str]]:
    """Rows of the table of one command."""
    counts = Counter((row["strike"], row["exit"], row["found"].partition(":")[0]) for row in kept.rows if row["command"] == name)
    keys = sorted({(kind, code) for kind, code, _ in counts})
    return [[name, *key, *(str(counts[(*key, way)] or "") for way in HEADS[3:])] for key in keys]


def totals(kept: Kept) -> list[str]:
    """Table of all commands together, a row for each kind of strike."""
    counts = Counter((row["strike"], row["found"].partition(":")[0]) for row in kept.rows)
    kinds = sorted({kind for kind, _ in counts})
    return table(("strike", *HEADS[3:]), [[kind, *(str(counts[kind, way]) for way in HEADS[3:])] for kind in kinds])


def commands(given: argparse.Namespace) -> int:
    """Kills, full disks and power cuts over the commands that write: what stands there afterwards is the old output or the new one, whole.

    Commands that replace what they wrote from other data, and commands that go on with a session that was interrupted. Their writes,
    synchronisations and renames below a folder are recorded once (``faults/system_call_faults.c``), those of programs that they start too.
    They are replayed up to each moment, as the system has them (SIGKILL there), and as a disk may hold them after a power cut. The disk
    then has only what was synchronised, or unsynchronised blocks and names by chance. Beside the replay the command is really run and
    killed at files that it opens, renames or removes, and with a disk that is full from its n-th write on. Then the next command's first
    step (``finish_set``) is taken and every file is compared; a session is resumed to its end. Linux, gcc.
    """
    library, kept = preload(), Kept(given.kept)
    with tempfile.TemporaryDirectory(prefix="strikes-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as place:
        work = Path(place)
        replacing, growing = cases(work), sessions(work)
        wanted = given.only or [*replacing, *growing, CHECK]
        if any(name not in growing for name in wanted):
            make_inputs(work)
        if any(name in replacing and (replacing[name].run_folder or replacing[name].runs) for name in wanted):
            make_run(work)
        for name in wanted:
            if name in growing:
                struck: Struck = ResumedSession(name, growing[name], work, library)
            elif name == CHECK:
                struck = MeasuredCheck(work, library)
            else:
                struck = ReplacedOutputs(name, replacing[name], work, library, given.moments)
            strike(struck, given.seed, kept)
            print("\n".join(table(HEADS, rows_of(name, kept))), flush=True)
    if given.write:
        put(PAGE, "\n".join(totals(kept)))
    bad = sum(row["found"].startswith("neither") for row in kept.rows)
    print(f"{len(kept.rows)} strikes, {bad} neither")
    return 1 if bad else 0
