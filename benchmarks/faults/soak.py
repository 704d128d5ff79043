"""Dry runs in a loop with random faults: does anything grow?"""

from __future__ import annotations

import argparse
import gc
import os
import random
import shutil
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

from bench import curve, svg, table, text

from faults.small_run import CELL, NOISE_MM, centres_of, three_poses

FAULTS = ("silence of the controller", "stop of the controller", "another artefact", "scanner reports a fault", "interrupted")
MEASURED = ("files", "threads", "processes", "abandoned shared memory", "memory, MB")
STARTED = time.time()


def state() -> tuple[int, int, int, int, float]:
    """Open files, threads, child processes, abandoned segments of shared memory, resident MB."""
    own = Path("/proc/self")
    status = dict(line.split(":\t", 1) for line in (own / "status").read_text().splitlines() if ":\t" in line)
    children = sum(len((task / "children").read_text().split()) for task in (own / "task").iterdir())
    return len(list((own / "fd").iterdir())), int(status["Threads"]), children, len(abandoned()), int(status["VmRSS"].split()[0]) / 1024


def abandoned() -> set[str]:
    """Segments of shared memory, made since the start, that no process has mapped any more."""
    mapped = ""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            mapped += "".join(line for line in (process / "maps").read_text().splitlines() if "/dev/shm/" in line)
    out = set()
    for path in Path("/dev/shm").iterdir():
        with suppress(OSError):
            if path.stat().st_mtime > STARTED and str(path) not in mapped:
                out.add(path.name)
    return out


def disturb(fake: object, what: str) -> None:
    if what == "silence of the controller":
        fake.faults.robot(silence=1)  # type: ignore[attr-defined]
    elif what == "stop of the controller":
        fake.faults.robot(stop=1)  # type: ignore[attr-defined]
    elif what == "another artefact":
        fake.faults.mishap("wrong_artefact", station="p1", artefact=None)  # type: ignore[attr-defined]
    elif what == "scanner reports a fault":
        fake.faults.scanner("status", {0x4528: -1})  # type: ignore[attr-defined]
    elif what == "interrupted":
        raise KeyboardInterrupt


def one_run(acquisition, loaded, poses, folder: Path, what: str, at: int) -> str:
    """How it ended."""
    from mbcacq.acquisition.events import PoseReached
    from mbcacq.devices import load_driver
    from mbcacq.errors import MbcacqError
    from mbcacq.recording.run_folder.lock import write_lock

    with load_driver("fakes", "cell")(loaded, poses, realtime=False, seed=3) as fake:

        def subscriber(event: object) -> None:
            if what and isinstance(event, PoseReached) and event.pose == at:
                disturb(fake, what)

        folder.mkdir()
        acquisition.folder, acquisition.simulated = folder, True
        try:
            with write_lock(folder, "run"):
                acquisition.execute(fake.overrides(), [subscriber])
        except MbcacqError as error:
            return type(error).__name__
        except KeyboardInterrupt:
            return "interrupted"
    return "well"


def chart(rows: list[tuple], file: Path) -> None:
    """One small curve for each quantity over the runs, as SVG."""
    width, height, parts = 640, 90, []
    for k, name in enumerate(MEASURED):
        values = [row[k] for row in rows]
        low, high = min(values), max(values)
        points = [
            (60 + 560 * i / max(len(values) - 1, 1), height * k + 75 - 55 * (v - low) / ((high - low) or 1)) for i, v in enumerate(values)
        ]
        parts += [text(60, height * k + 14, name), text(4, height * k + 24, f"{high:.0f}"), text(4, height * k + 78, f"{low:.0f}")]
        parts.append(curve(points, "#0072b2"))
    file.write_text(svg(width, height * len(MEASURED), parts), encoding="utf-8")


def soak(given: argparse.Namespace) -> int:
    """Dry runs in a loop with random faults: does anything grow? Files, threads, processes, shared memory and memory, as a chart.

    One process makes all runs, as a program does that uses mbcacq as a library. Every second run is disturbed: a fault of the fake
    controller or scanner, or an interruption. The measurements of every run are compared with those of the first. Linux.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    import numpy as np

    from mbcacq.plan import expand, load
    from mbcacq.workflow import acquire

    work = Path(tempfile.mkdtemp(prefix="soak-"))
    loaded = load(three_poses(work))
    poses = expand(loaded)
    acquisition = acquire.plan_acquisition(loaded, poses, frozenset(), 0, CELL)
    rng, began, rows, ended, first, wrong = random.Random(given.seed), time.monotonic(), [], Counter(), {}, 0
    while time.monotonic() - began < 60 * given.minutes:
        number = len(rows)
        what = rng.choice(FAULTS) if number % 2 else ""
        folder = work / "run"
        how = one_run(acquisition, loaded, poses, folder, what, rng.randrange(len(poses)))
        ended[what or "undisturbed", how] += 1
        found = centres_of(folder) if how == "well" else {}
        first = first or found
        off = [key for key, xyz in found.items() if key in first and np.abs(xyz - first[key]).max() > NOISE_MM]
        wrong += bool(off) or (not what and how != "well")
        shutil.rmtree(folder)
        gc.collect()
        rows.append(state())
        print(f"{number} {what or '-'}: {how}; " + ", ".join(f"{v:.0f} {n}" for v, n in zip(rows[-1], MEASURED, strict=True)), flush=True)
    shutil.rmtree(work)
    chart(rows, given.chart)
    print("", *table(["disturbed by", "ended", "runs"], [[*key, count] for key, count in sorted(ended.items())]), sep="\n")
    settled = rows[len(rows) // 4 :] or rows
    growth = {name: settled[-1][k] - settled[0][k] for k, name in enumerate(MEASURED)}
    print(f"\n{len(rows)} runs in {(time.monotonic() - began) / 60:.0f} min, {wrong} wrong; growth over the last three quarters: {growth}")
    return 1 if wrong else 0
