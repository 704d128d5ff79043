"""One flipped bit anywhere in the files of a run."""

from __future__ import annotations

import argparse
import random
import shutil
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import synthetic

from mbcacq.acquisition.events import RunStarted
from mbcacq.errors import MbcacqError
from mbcacq.model.observations import Observations
from mbcacq.recording import load_observations
from mbcacq.recording.rrd.reader import opened_once
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.recording.run_folder.check import check
from mbcacq.recording.run_folder.journal import Journal
from mbcacq.recording.run_folder.run_plan import keep_plan, plan_files_text


def record(folder: Path) -> None:
    files = plan_files_text({"robot.yaml": "name: made\n"}, "the fake cell of seed 0")
    keep_plan(folder, synthetic.PLAN, files)
    with Recorder(folder) as recorder, Journal(folder) as journal:
        for event in synthetic.run(n_poses=4):
            event = replace(event, plan_files=files) if isinstance(event, RunStarted) else event
            recorder(event)
            journal(event)


def compared(loaded: Observations, true: Observations) -> str:
    """Whether what was loaded is a part of the true observations."""
    q_of = dict(zip(true.pose_id.tolist(), map(bytes, true.q), strict=True))
    xyz_of = {(int(p), int(b)): bytes(x) for p, b, x in zip(true.pose_id[true.pose], true.ball, true.xyz, strict=True)}
    centres = zip(loaded.pose_id[loaded.pose], loaded.ball, loaded.xyz, strict=True)
    right = loaded.cell_yaml == true.cell_yaml
    right &= all(q_of.get(pose) == bytes(q) for pose, q in zip(loaded.pose_id.tolist(), loaded.q, strict=True))
    right &= all(xyz_of.get((int(pose), int(ball))) == bytes(xyz) for pose, ball, xyz in centres)
    return ("all poses" if loaded.n_poses == true.n_poses else "poses left out") if right else "WRONG"


def flipped_bits(given: argparse.Namespace) -> int:
    """One flipped bit anywhere in the files of a run: is it found, and does it ever become a wrong observation without a word?

    The run is a small synthetic one. Every flip is checked by `recover --check` (as a library call), then the observations are loaded. They
    must be a part of the true ones, bit for bit, or loading must end in one of our errors.
    """
    work = Path(tempfile.mkdtemp(prefix="flips-"))
    record(work / "true")
    true = load_observations(work / "true")
    shutil.copytree(work / "true", work / "run")
    names = sorted(path.name for path in (work / "true").iterdir() if path.stat().st_size)
    sizes = [(work / "true" / name).stat().st_size for name in names]
    rng, table, bad = random.Random(given.seed), Counter(), 0
    end = time.monotonic() + 60 * given.minutes
    for number in range(given.flips):
        if time.monotonic() > end:
            break
        name = rng.choice(names) if number % 2 else rng.choices(names, sizes)[0]  # half by file, half by size
        path, data = work / "run" / name, bytearray((work / "true" / name).read_bytes())
        at = rng.randrange(len(data))
        data[at] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        with opened_once():
            found = any(file.faults for file in check(work / "run") if file.path == path)
            try:
                loaded: Observations | None = load_observations(work / "run")
            except MbcacqError:
                loaded = None
        how = "refused" if loaded is None else compared(loaded, true)
        table[name, "found" if found else "NOT FOUND", how] += 1
        if not found or how == "WRONG":
            bad += 1
            print(f"  {name} byte {at}: found: {found}, {how}", flush=True)
        shutil.copy(work / "true" / name, path)
    shutil.rmtree(work)
    print("| file | check | observations | flips |\n|---|---|---|---|")
    for (name, found, how), count in sorted(table.items()):
        print(f"| {name} | {found} | {how} | {count} |")
    print(f"\n{sum(table.values())} flips, {bad} not good")
    return 1 if bad else 0
