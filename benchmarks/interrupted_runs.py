"""What a run leaves on the disk: after kill -9 and a resumption, after a power cut, with a flipped bit.

    python benchmarks/interrupted_runs.py kills [--rounds 50] [--seed 1]
    python benchmarks/interrupted_runs.py power-cuts [--moments 60] [--seed 0] [--resume-every 10]
    python benchmarks/interrupted_runs.py flipped-bits [--flips 2000] [--seed 0] [--minutes M]

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import bench
import synthetic
from bench import MBCACQ, counted, option
from faults.preloaded import preload
from faults.replayed_disk import Disk, records
from faults.small_run import CELL, DisturbedRuns, Ending, compare, two_stations

from mbcacq.acquisition.events import RunStarted
from mbcacq.errors import MbcacqError
from mbcacq.model.observations import Observations
from mbcacq.recording import Journal, Recorder, load_observations
from mbcacq.recording.rrd.reader import opened_once
from mbcacq.recording.run_folder.check import check
from mbcacq.recording.run_folder.run_plan import keep_plan, plan_files_text

EARLY, LATE = 0.3, 1.5  # s before the first motion and after the last that a kill may hit as well


def start(*arguments: object) -> subprocess.Popen:
    return subprocess.Popen(
        [MBCACQ, "run", *map(str, arguments), "--dry-run", "--json"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def one_round(plan: Path, folder: Path, after_s: float, whole) -> tuple[str, str]:
    """Kill a run so many seconds after its folder came to be, resume it. Returns where the kill hit, and what differs ('' for nothing)."""
    process = start(plan, "--out", folder)
    while not (folder / "plan.yaml").exists() and process.poll() is None:
        time.sleep(0.002)
    time.sleep(after_s)
    if process.poll() is not None:
        return "after the end", compare(folder, whole)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    journal = folder / "journal.jsonl"
    poses = journal.read_text(encoding="utf-8").count("pose_done") if journal.exists() else -1
    hit = (
        "before the journal"
        if poses < 0
        else "before the first pose"
        if not poses
        else "between the poses"
        if poses < len(whole.pose_id)
        else "after the last pose"
    )
    again = start(plan, *(("--resume", folder) if (folder / "plan.yaml").exists() else ("--out", folder)))
    _, text = again.communicate(timeout=300)
    return hit, compare(folder, whole) if again.returncode == 0 else f"exit code {again.returncode}: {text.strip()[-300:]}"


def kills(given: argparse.Namespace) -> int:
    """kill -9 at random moments of a run, then --resume: is the final observation set that of an undisturbed run?

    The fake cell draws its noise by pose here (``fake: {draws: pose}``), so that two runs can be compared number by number, not only
    within noise. The whole process group is killed: the run, its RSI process, the fake controller, the fake scanner. Exit code 0 if
    all rounds agree.
    """
    rng, hits, bad = random.Random(given.seed), Counter(), 0
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        plan = two_stations(work)
        first = start(plan, "--out", work / "whole")
        _, text = first.communicate(timeout=300)
        if first.returncode:
            print(text)
            return 1
        whole = load_observations(work / "whole")
        length = json.loads((work / "whole" / "journal.jsonl").read_text(encoding="utf-8").splitlines()[-1])["time_s"]
        print(f"undisturbed: {whole.n_poses} poses, {whole.n_centres} centres, {length:.1f} s from connecting to the end", flush=True)
        for number in range(given.rounds):
            after = rng.uniform(0.0, EARLY + length + LATE)
            hit, differs = one_round(plan, work / "run", after, whole)
            hits[hit] += 1
            bad += bool(differs)
            print(f"{number + 1:3} killed after {after:5.2f} s, {hit}: {differs or 'equal'}", flush=True)
            shutil.rmtree(work / "run", ignore_errors=True)
    print(f"{given.rounds} kills ({', '.join(f'{n} {hit}' for hit, n in hits.items())}): {given.rounds - bad} equal, {bad} not")
    return 1 if bad else 0


def power_cuts(given: argparse.Namespace) -> int:
    """A power cut at a moment of a run: what was written since the last sync is lost. Can the folder be resumed, and is nothing wrong?

    ``system_call_faults.c`` records every write, sync, rename and new name below the folder of a run. For a moment drawn among these
    records the folder is built as a disk could hold it then: 'lost' keeps only what was synced (contents by fsync of the file, names
    by fsync of the folder), 'some' keeps each unsynced block of 4 KiB and each unsynced name with probability one half. Then the run
    is resumed, every so often to its end. Linux, gcc.
    """
    runs = DisturbedRuns(preload())
    from mbcacq.workflow.resume import resumed_progress

    whole, log = runs.work / "whole", runs.work / "log"
    ending = runs.run(lambda: runs.library.fault_record(str(whole).encode(), str(log).encode()), whole, False)
    assert ending.how == "goes on", ending
    found = list(records(log.read_bytes()))
    replayed = Disk()
    for record in found:
        replayed.apply(record)
    for name, file in replayed.names.items():  # the log is complete, or nothing below is worth anything
        if (whole / name).is_file() and name != ".run.lock.json":
            assert (whole / name).read_bytes() == bytes(file.content), name
    print(f"{len(found)} records: " + ", ".join(f"{n} {kind}" for kind, n in Counter(record.kind for record in found).items()), flush=True)
    rng, table, bad = random.Random(given.seed), Counter(), 0
    for case in range(given.moments):
        moment, how = rng.randrange(len(found) + 1), ("lost", "some")[case % 2]
        disk = Disk()
        for record in found[:moment]:
            disk.apply(record)
        folder = runs.work / "cut"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for name, content in disk.after_cut(rng if how == "some" else None).items():
            (folder / name).write_bytes(content)
        wrong = runs.left_behind(folder, Ending("cut"))
        if not wrong and case % given.resume_every == 0 and (folder / "plan.yaml").exists():
            wrong = runs.resumed(folder)
        held = len(resumed_progress(folder, runs.loaded, CELL).done) if not wrong and (folder / "plan.yaml").exists() else 0
        table[how, "not good" if wrong else f"{held} poses kept"] += 1
        bad += bool(wrong)
        if wrong:
            print(f"  {how} at record {moment}: {'; '.join(wrong)}", flush=True)
    runs.close()
    print("", *counted(table, ["unsynced writes"], sorted({way for _, way in table})), sep="\n")
    print(f"\n{given.moments} moments, {bad} not good")
    return 1 if bad else 0


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

    The run is a small synthetic one. Every flip is checked by `recover --check` (as a library call), then the observations are
    loaded: what is loaded must be a part of the true ones, bit for bit, or loading must end in one of our errors.
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


if __name__ == "__main__":
    SEED = option("--seed", type=int, default=0)
    MINUTES = option("--minutes", type=float, default=1e9, help="begin no further flip after this time")
    CUTS = [option("--moments", type=int, default=60), SEED, option("--resume-every", type=int, default=10)]
    commands = {
        "kills": (kills, [option("--rounds", type=int, default=50), option("--seed", type=int, default=1)]),
        "power-cuts": (power_cuts, CUTS),
        "flipped-bits": (flipped_bits, [option("--flips", type=int, default=2000), SEED, MINUTES]),
    }
    sys.exit(bench.main(__doc__, commands))
