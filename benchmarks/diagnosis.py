"""Time and memory of ``mbcacq diagnose`` as whole processes, start of the interpreter included. Writes benchmarks/diagnosis.md.

    python benchmarks/diagnosis.py [--tracker ../shared/data/ur10-tracker-a]

Made recordings: ``plans/seeing.yaml``, 128 poses before balls and bar (605 centres), and 128 poses at 16 stations that see all eight balls
(1024 centres), with nothing, one and two effects concealed, and one without a name. --tracker: a long recording besides.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests" / "diagnosis"))  # its simulated cells
MBCACQ = Path(sys.executable).parent / "mbcacq"
CASES = (
    ("nothing concealed", "none", 41),
    ("an elastic joint", "joint_compliance", 42),
    ("two effects", "two", 43),
    ("an effect without a name", "link_bending", 44),
)
LIMITS = {"made": (8.0, 2.0), "tracker": (25.0, 2.0)}
ELASTIC = ("joint_compliance", ("A2",), [2.5e-6], None)
SLIPPED = ("mount_shift", ("mount",), [0.02, 0.01, -0.02, 1e-4, -5e-5, 5e-5], 60.0)
INTRODUCTION = """# Diagnosis: time and memory

Made by `python benchmarks/diagnosis.py --tracker ../shared/data/ur10-tracker-a`: whole processes with the full catalogue and the proof on
data left out, on two cores: the process itself and one more share the proof, each with one thread of linear algebra. Memory is that of the
larger one.
How right it is: [challenge.md](challenge.md). What stands below the table was written by hand.

| recording | poses | centres | wall, s | processor, s | memory, GiB | asked: wall, memory |
|---|--:|--:|--:|--:|--:|---|"""
END = "<!-- end -->\n"  # what is below stays as it was written


def made(effect: str, seed: int, folder: Path) -> Path:
    """An observation set of a challenge."""
    subprocess.run(
        [MBCACQ, "challenge", "--fast", "--effects", effect, "--seed", str(seed), "--count", "1", "--out", folder],
        check=True,
        capture_output=True,
    )
    return next(folder.rglob("observations"))


def twist(s):
    """Torsion of link 2 about its length, under the moment about it, until it saturates: no effect of the catalogue."""
    from mbcacq.estimation.forward_model import Displacements

    moment = s.gravity_moment(2)[:, 0]
    frame = np.zeros((s.obs.n_poses, s.n + 1, 6))
    frame[:, 2, 3] = 6e-4 * np.tanh(moment / (2 * moment.std()))
    return Displacements(frame=frame)


ALL_SEEN = (("nothing", []), ("an elastic joint", [ELASTIC]), ("two effects", [ELASTIC, SLIPPED]), ("an effect without a name", [twist]))


def all_seen(effects: list, folder: Path) -> Path:
    """An observation set of 128 poses that see eight balls each."""
    import simulated as cells

    from mbcacq.recording import write_observation_set

    write_observation_set(cells.observe(cells.plan(stations=16, bars=0, each=8), 300, effects), folder)
    return folder


def measured(data: Path) -> tuple[float, float, float]:
    """Wall s, processor s, largest resident memory in GiB."""
    start = time.perf_counter()
    process = subprocess.Popen([MBCACQ, "diagnose", data], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"diagnose {data} ended with {os.waitstatus_to_exitcode(status)}")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20


def row(name: str, data: Path, kind: str) -> str:
    poses, centres = (sum(1 for _ in (data / name).open()) - 1 for name in ("poses.csv", "centres.csv"))
    wall, processor, memory = measured(data)
    limit, most = LIMITS[kind]
    return f"| {name} | {poses} | {centres} | {wall:.1f} | {processor:.1f} | {memory:.2f} | {limit:g} s, {most:g} GiB |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tracker", type=Path)
    options = parser.parse_args()
    lines = [INTRODUCTION]
    for name, effect, seed in CASES:
        with tempfile.TemporaryDirectory() as folder:
            lines.append(row(name, made(effect, seed, Path(folder)), "made"))
        print(lines[-1], flush=True)
    for name, effects in ALL_SEEN:
        with tempfile.TemporaryDirectory() as folder:
            lines.append(row(f"all balls seen, {name}", all_seen(effects, Path(folder)), "made"))
        print(lines[-1], flush=True)
    if options.tracker is not None:
        lines.append(row(options.tracker.name, options.tracker, "tracker"))
        print(lines[-1])
    page = HERE / "diagnosis.md"
    below = page.read_text(encoding="utf-8").partition(END)[2]
    page.write_text("\n".join(lines) + f"\n\n{END}{below}", encoding="utf-8")


if __name__ == "__main__":
    main()
