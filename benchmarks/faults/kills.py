"""kill -9 at random moments of a run, then a resumption."""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import tempfile
import time
from collections import Counter
from pathlib import Path

from bench import MBCACQ

from faults.small_run import compare, two_stations
from mbcacq.recording import load_observations

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
