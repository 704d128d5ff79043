"""kill -9 at random moments of a run, then --resume: is the final observation set that of an undisturbed run?

    python benchmarks/kill_and_resume.py [--rounds 50] [--seed 1]

The fake cell draws its noise by pose here (``fake: {draws: pose}``), so that two runs can be compared number by number, not only within
noise. The whole process group is killed: the run, its RSI process, the fake controller, the fake scanner. Exit code 0 if all rounds agree.
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
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).parents[1]
MBCACQ = Path(sys.executable).parent / "mbcacq"
EARLY, LATE = 0.3, 1.5  # s before the first motion and after the last that a kill may hit as well
SAME_Q = 1e-12  # rad; the mean over another number of equal cycles differs in its last bits


def plan_file(folder: Path) -> Path:
    """plans/quick.yaml with a second station, noise drawn by pose."""
    plan = yaml.safe_load((ROOT / "plans" / "quick.yaml").read_text(encoding="utf-8"))
    plan["robot"]["model"] = str(ROOT / "plans" / plan["robot"]["model"])
    plan["artefacts"] = [str(ROOT / "plans" / name) for name in plan["artefacts"]]
    plan["stations"].append({"id": "p2", "artefact": "mbc", "pose_in_base": {"translation_mm": [560, 160, 120], "abc_deg": [20, 0, 0]}})
    plan["steps"][1]["stations"] = ["p1", "p2"]
    plan["exposures"] = 3
    plan["fake"] = {"draws": "pose"}
    path = folder / "plan.yaml"
    path.write_text(yaml.safe_dump(plan, sort_keys=False), encoding="utf-8")
    return path


def start(*arguments: object) -> subprocess.Popen:
    return subprocess.Popen(
        [MBCACQ, "run", *map(str, arguments), "--dry-run", "--json"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def compare(folder: Path, whole) -> str:
    """'' if the observations of a run folder are those of the undisturbed run, else the first thing that differs."""
    return next(differences(folder, whole), "")


def differences(folder: Path, whole) -> Iterator[str]:
    """What differs between a run folder and the undisturbed run, in words; nothing more once poses or balls are others."""
    from mbcacq.recording import load_observations

    found = load_observations(folder)
    if sorted(found.pose_id.tolist()) != whole.pose_id.tolist():
        yield f"poses {sorted(found.pose_id.tolist())}"
        return
    order = np.argsort(found.pose_id)
    rank = np.argsort(order)
    rows = np.lexsort((np.arange(found.n_centres), rank[found.pose]))
    if not np.array_equal(found.ball[rows], whole.ball):
        yield "other balls"
        return
    if not np.array_equal(found.xyz[rows], whole.xyz):
        yield f"centres differ by up to {np.abs(found.xyz[rows] - whole.xyz).max():.2e} mm"
    if (away := np.abs(found.q[order] - whole.q).max()) > SAME_Q:
        yield f"joint angles differ by up to {away:.2e} rad"
    if not np.array_equal(found.direction[order], whole.direction):
        yield "the arm came from another side"
    merged = load_observations(folder / "whole.rrd") if (folder / "whole.rrd").exists() else found
    if not np.array_equal(merged.xyz, found.xyz) or not np.array_equal(merged.q, found.q):
        yield "the merged recording differs from its parts"


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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    from mbcacq.recording import load_observations

    rng, hits, bad = random.Random(options.seed), Counter(), 0
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        plan = plan_file(work)
        first = start(plan, "--out", work / "whole")
        _, text = first.communicate(timeout=300)
        if first.returncode:
            print(text)
            return 1
        whole = load_observations(work / "whole")
        length = json.loads((work / "whole" / "journal.jsonl").read_text(encoding="utf-8").splitlines()[-1])["time_s"]
        print(f"undisturbed: {whole.n_poses} poses, {whole.n_centres} centres, {length:.1f} s from connecting to the end", flush=True)
        for number in range(options.rounds):
            after = rng.uniform(0.0, EARLY + length + LATE)
            hit, differs = one_round(plan, work / "run", after, whole)
            hits[hit] += 1
            bad += bool(differs)
            print(f"{number + 1:3} killed after {after:5.2f} s, {hit}: {differs or 'equal'}", flush=True)
            shutil.rmtree(work / "run", ignore_errors=True)
    print(f"{options.rounds} kills ({', '.join(f'{n} {hit}' for hit, n in hits.items())}): {options.rounds - bad} equal, {bad} not")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
