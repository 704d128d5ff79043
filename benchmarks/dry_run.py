"""Where the time of a dry run goes: processor time by process, wall time by state of the run.

    python benchmarks/dry_run.py [--plan plans/kuka.yaml]

The processes are watched from outside, so nothing in them is slowed down. Other work on the machine lengthens the wall time and, on cores
that share caches, the processor time too: the load is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[1]
NAMES = {
    "mbcacq_fakes.cell.process": "fake scanner (ray casting, encoding)",
    "mbcacq_fakes.protocols.krc.process": "fake controller (one telegram a cycle)",
    "mbcacq_kuka.rsi.cycle": "driver's cycle (one answer a telegram)",
}


def processor_times(process: psutil.Process, seen: dict[str, float]) -> None:
    """Update name of a process -> s of processor time, of a process and all below it."""
    for each in [process, *process.children(recursive=True)]:
        try:
            line, times = " ".join(each.cmdline()), each.cpu_times()
        except psutil.Error:
            continue
        name = next((text for module, text in NAMES.items() if module in line), "mbcacq itself" if each.pid == process.pid else "others")
        seen[name] = times.user + times.system


def parts_of(run: Path) -> dict[str, float]:
    """Wall time (s) of a run in each state, by its report's own reading of the recording."""
    from mbcacq.report.sources.devices import devices_of

    devices = devices_of(run)
    return dict(devices.state_s) if devices else {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plan", default="plans/kuka.yaml")
    plan = parser.parse_args().plan
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        command = [str(Path(sys.executable).parent / "mbcacq"), "run", plan, "--dry-run", "--json", "--out", str(run)]
        began, load = time.monotonic(), os.getloadavg()[0]
        process = psutil.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        seen: dict[str, float] = {}
        while process.poll() is None:
            processor_times(process, seen)
            time.sleep(0.2)
        wall = time.monotonic() - began
        rows = {"wall_s": round(wall, 1), "load_before": load, "load_after": os.getloadavg()[0]}
        print(json.dumps(rows | {"processor_s": {k: round(v, 1) for k, v in seen.items()}}, indent=1))
        print(json.dumps({"state_s": {k: round(v, 1) for k, v in parts_of(run).items()}}, indent=1))


if __name__ == "__main__":
    main()
