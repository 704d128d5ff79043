"""How soon is an RSI telegram answered? Measured where it counts: at the (fake) controller, every 4 ms, by the clock.

python benchmarks/rsi_latency.py --seconds 30 --load both --lock-step --write
"""

from __future__ import annotations

import argparse
import os
import platform
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from mbcacq_fakes.protocols.krc import FakeKrc
from mbcacq_kuka.rsi.driver import KukaRsi

from mbcacq.devices import MotionLimits

LIMITS_DEG = [(-185, 185), (-140, 10), (-120, 168), (-350, 350), (-125, 125), (-350, 350)]
HOME_DEG = np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
MOTION = MotionLimits(*(np.radians(np.full(6, v)) for v in (90.0, 360.0, 3600.0)))

LOAD = """
import sys, tempfile, time
import numpy as np, rerun as rr
rng = np.random.default_rng(0)
raw = rng.integers(-30000, 30000, (800, 1280, 3), dtype=np.int16).tobytes()
with tempfile.TemporaryDirectory() as folder:
    recording = rr.RecordingStream("load")
    recording.save(folder + "/load.rrd")
    print("up", flush=True)
    for i in range(10**9):
        grid = np.frombuffer(raw, np.int16).reshape(-1, 3).astype(np.float32) * 0.01
        points = grid[np.isfinite(grid).all(axis=1)][::10]
        recording.set_time("pose", sequence=i)
        recording.log("scan", rr.Points3D(points))
        if i % 20 == 0:
            recording.save(folder + "/load.rrd")
        time.sleep(0.005)
"""


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seconds", type=float, default=20.0)
    arguments.add_argument(
        "--load", choices=("none", "scans", "both"), default="both", help="another process decodes scans and logs them to rerun"
    )
    arguments.add_argument("--lock-step", action="store_true", help="also time a plan's worth of cycles as fast as they go")
    arguments.add_argument("--write", action="store_true", help="write the figures to rsi_latency.md")
    given = arguments.parse_args()
    rows = [measure(given.seconds, load) for load in {"none": (False,), "scans": (True,), "both": (False, True)}[given.load]]
    text = report(rows, lock_step() if given.lock_step else None)
    print(text)
    if given.write:
        Path(__file__).with_suffix(".md").write_text(text)


def measure(seconds: float, loaded: bool) -> dict[str, float]:
    port = free_port()
    load = subprocess.Popen([sys.executable, "-c", LOAD], stdout=subprocess.PIPE, text=True) if loaded else None
    try:
        if load is not None:
            load.stdout.readline()
        with (
            FakeKrc(
                client=("127.0.0.1", port), realtime=True, log=True, timeout=10**9, start_deg=tuple(HOME_DEG), limits_deg=LIMITS_DEG
            ) as krc,
            KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port, "late_limit": 10**8}) as robot,
        ):
            before = krc.counters()["late"]
            end, i = time.monotonic() + seconds, 0
            while time.monotonic() < end:
                robot.move_to(np.radians(HOME_DEG + [20.0 * (i % 2), 5.0 * (i % 3), 0.0, 30.0 * (i % 2), 0.0, 0.0]), MOTION)
                while not robot.state().arrived and time.monotonic() < end:
                    time.sleep(0.003)
                robot.cycles()
                i += 1
            missed = krc.counters()["late"] - before
            log, fifo = krc.log(), robot.real_time
    finally:
        if load is not None:
            load.kill()
            load.communicate()
    latency = log["latency_s"][log["accepted"]] * 1e6
    return {
        "loaded": loaded,
        "fifo": fifo,
        "cycles": len(latency),
        "median": np.median(latency),
        "p999": np.percentile(latency, 99.9),
        "worst": latency.max(),
        "missed": missed,
    }


def lock_step(n: int = 60) -> tuple[int, float]:
    """Cycles and seconds of a row of motions in lock-step."""
    port = free_port()
    with (
        FakeKrc(client=("127.0.0.1", port), realtime=False, start_deg=tuple(HOME_DEG), limits_deg=LIMITS_DEG) as krc,
        KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port}) as robot,
    ):
        rng, start = np.random.default_rng(0), time.perf_counter()
        cycles = 0
        for _ in range(n):
            robot.move_to(np.radians(HOME_DEG + rng.uniform(-45, 45, 6)), MOTION)
            while not robot.state().arrived:
                time.sleep(0.003)
            cycles += len(robot.cycles())
        assert krc.counters()["late"] == 0
        return cycles, time.perf_counter() - start


def report(rows: list[dict[str, float]], plan: tuple[int, float] | None) -> str:
    lines = [
        "# Reply latency of the RSI cycle",
        "",
        f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, loopback, 4 ms by the clock; from "
        "sending a telegram to having the answer, at the controller's side. The machine was shared with other work: the median is a "
        "property of the program, the tail mostly of the machine.",
        "",
        "| other load | SCHED_FIFO | cycles | median us | 99.9 % us | worst us | missed |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        load, fifo = "decoding scans and logging to rerun" if r["loaded"] else "none of ours", "yes" if r["fifo"] else "no"
        lines.append(f"| {load} | {fifo} | {r['cycles']} | {r['median']:.0f} | {r['p999']:.0f} | {r['worst']:.0f} | {r['missed']} |")
    if plan is not None:
        cycles, seconds = plan
        lines += ["", f"Lock-step, both sides: {cycles} cycles in {seconds:.1f} s, {seconds / cycles * 1e6:.0f} us a cycle."]
    return "\n".join(lines) + "\n"


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


if __name__ == "__main__":
    main()
