"""A power cut at a moment of a run."""

from __future__ import annotations

import argparse
import random
import shutil
from collections import Counter

from bench import counted

from faults.preloaded import preload
from faults.replayed_disk import Disk, records
from faults.small_run import CELL, DisturbedRuns, Ending


def power_cuts(given: argparse.Namespace) -> int:
    """A power cut at a moment of a run: what was written since the last sync is lost. Can the folder be resumed, and is nothing wrong?

    ``system_call_faults.c`` records every write, sync, rename and new name below the folder of a run. For a moment drawn among these
    records the folder is built as a disk could hold it then. 'lost' keeps only what was synced (contents by fsync of the file, names by
    fsync of the folder). 'some' keeps each unsynced block of 4 KiB and each unsynced name with probability one half. Then the run is
    resumed, every so often to its end. Linux, gcc.
    """
    runs = DisturbedRuns(preload())
    from mbcacq.workflow.resume import progress_before

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
        held = len(progress_before(folder, runs.loaded, CELL, str).done) if not wrong and (folder / "plan.yaml").exists() else 0
        table[how, "not good" if wrong else f"{held} poses kept"] += 1
        bad += bool(wrong)
        if wrong:
            print(f"  {how} at record {moment}: {'; '.join(wrong)}", flush=True)
    runs.close()
    print("", *counted(table, ["unsynced writes"], sorted({way for _, way in table})), sep="\n")
    print(f"\n{given.moments} moments, {bad} not good")
    return 1 if bad else 0
