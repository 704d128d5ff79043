"""How soon an RSI telegram is answered."""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from bench import HERE
from mbcacq_kuka.rsi.driver import KukaRsi

from mbcacq.devices import MbcacqError, MotionLimits

LIMITS_DEG = [(-185, 185), (-140, 10), (-120, 168), (-350, 350), (-125, 125), (-350, 350)]
HOME_DEG = np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
STALL_S = 0.05  # what two programs miss within such a time is the machine's
FLOOR = "C, answers only"
MOTION = MotionLimits(np.radians(np.full(6, 90.0)), np.radians(np.full(6, 360.0)), np.radians(np.full(6, 3600.0)))

LOAD = """
import tempfile, time
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

COMPUTES = """
import json
print("up", flush=True)
while True:
    json.loads(json.dumps([{"axis": i, "name": str(i)} for i in range(1000)]))
"""
COPIES = """
import numpy as np
here, there = np.ones(2**24, np.uint8), np.ones(2**24, np.uint8)
print("up", flush=True)
while True:
    there[:] = here
    here += there
"""

RSIPI_CONFIG = """<ROOT>
<CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>{port}</PORT><SENTYPE>ImFree</SENTYPE><ONLYSEND>FALSE</ONLYSEND></CONFIG>
<SEND><ELEMENTS>
<ELEMENT TAG="DEF_RIst" TYPE="DOUBLE" INDX="INTERNAL"/><ELEMENT TAG="DEF_RSol" TYPE="DOUBLE" INDX="INTERNAL"/>
<ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL"/><ELEMENT TAG="DEF_ASPos" TYPE="DOUBLE" INDX="INTERNAL"/>
<ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/>
</ELEMENTS></SEND>
<RECEIVE><ELEMENTS>{axes}</ELEMENTS></RECEIVE></ROOT>
"""
RSIPI_CLIENT = """
import sys
from RSIPI import RSIAPI
if __name__ == "__main__":
    api = RSIAPI(sys.argv[1], rsi_mode="absolute")
    api.start()
    print("up", flush=True)
    sys.stdin.read()
    api.stop()
"""


def latency(given: argparse.Namespace) -> None:
    """How soon is an RSI telegram answered? Measured where it counts: at the controller, every 4 ms, by the clock.

    Ours against RSIPI (PyPI ``rsipi``) and against a C program of 60 lines that does nothing but answer, which is the floor of what
    this machine can do. The controller is a C program, too, so that its own time does not count. Each round lets every program answer
    for the given time, one after the other, so that all of them see the same machine. With --together one controller asks the C
    program and ours in turn within each cycle, 2 ms apart: a virtual machine is stopped for some cycles now and then, which hits both
    alike then. Medians are to be taken by turns: two programs keep the processor awake for each other. Three rounds of 60 s each, idle
    and under scan load, take 18 minutes on a quiet machine.
    """
    found: dict[tuple[str, str], list[Heard]] = {}
    busy = [os.getloadavg()[0]]
    with tempfile.TemporaryDirectory() as folder:
        metronome, echo = (compiled(name, Path(folder)) for name in ("rsi_metronome", "rsi_echo"))
        programs: dict[str, Callable] = {FLOOR: lambda port: c_echo(echo, port), "mbcacq": ours}
        if find_spec("RSIPI") is None:
            print("RSIPI is not installed (pip install rsipi): left out")
        elif not given.together:
            programs["RSIPI"] = lambda port: rsipi(port, Path(folder))
        turns = [programs] if given.together else [{name: program} for name, program in programs.items()]
        for load in given.load:
            for _ in range(given.rounds):
                with busy_programs(load, given.programs):
                    for turn in turns:
                        for name, heard in measure(metronome, turn, given.seconds).items():
                            found.setdefault((load, name), []).append(heard)
                        busy.append(os.getloadavg()[0])
    text = report(found, busy, given)
    print(text)
    if given.write:
        HERE / "rsi_latency.md".write_text(text)


def compiled(name: str, folder: Path) -> Path:
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        sys.exit("no C compiler (cc, gcc): the controller and the floor of this benchmark are C programs")
    subprocess.run([compiler, "-O2", "-o", str(folder / name), str(Path(__file__).with_name(f"{name}.c"))], check=True)
    return folder / name


@dataclass(frozen=True)
class Heard:
    """Each telegram of one program: the time when it was sent, s (n,), and the latency in us (n,), negative for a cycle without an answer.
    Also the processor time that its process took meanwhile, s."""

    sent_s: np.ndarray
    latency_us: np.ndarray
    processor_s: float


def measure(metronome: Path, programs: dict[str, Callable], seconds: int) -> dict[str, Heard]:
    """All of the programs are asked by one controller, which begins when the last of them is ready."""
    ports = free_ports(len(programs))
    controller: list[subprocess.Popen[bytes]] = []
    waiting = list(programs)

    def begin() -> None:
        waiting.pop()
        if not waiting:
            controller.append(subprocess.Popen([str(metronome), str(seconds), *map(str, ports)], stdout=subprocess.PIPE))

    with ExitStack() as running:
        pids = [running.enter_context(program(port)(begin)) for program, port in zip(programs.values(), ports, strict=True)]
        before = [processor_s(pid) for pid in pids]
        data, _ = controller[0].communicate()
        taken = [processor_s(pid) - start for pid, start in zip(pids, before, strict=True)]
    rows = np.frombuffer(data, dtype=float).reshape(-1, 3)
    own = [rows[rows[:, 0] == k] for k in range(len(programs))]
    return {name: Heard(own[k][:, 1], own[k][:, 2], taken[k]) for k, name in enumerate(programs)}


def processor_s(pid: int) -> float:
    """Processor time of a process so far, user and system."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def child(module: str) -> int:
    """Process id of this process' child that runs ``module``."""
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == os.getpid() and module.encode() in (entry / "cmdline").read_bytes():
                return int(entry.name)
    raise ProcessLookupError(module)


@contextmanager
def waiting_program(command: list[str], begin: Callable[[], object], folder: Path | None = None) -> Iterator[int]:
    """A program that says when it listens and ends with its standard input. Yields its process id."""
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=folder, text=True
    ) as process:
        assert process.stdout is not None  # a pipe
        while process.stdout.readline().strip() != "up":
            assert process.poll() is None, f"{command[0]} did not start"
        begin()
        yield process.pid
        process.terminate()


def c_echo(program: Path, port: int) -> Callable:
    return lambda begin: waiting_program([str(program), str(port)], begin)


def rsipi(port: int, folder: Path) -> Callable:
    axes = "".join(f'<ELEMENT TAG="AKorr.A{i}" TYPE="DOUBLE" INDX="{i}" HOLDON="1"/>' for i in range(1, 7))
    (folder / "config.xml").write_text(RSIPI_CONFIG.format(port=port, axes=axes))
    (folder / "client.py").write_text(RSIPI_CLIENT)
    return lambda begin: waiting_program([sys.executable, "client.py", "config.xml"], begin, folder)


def ours(port: int) -> Callable:
    @contextmanager
    def program(begin: Callable[[], object]) -> Iterator[int]:
        options = {"limits_deg": LIMITS_DEG, "port": port, "late_limit": 10**8, "stop_at_close": False, "check_set_point": False}
        ended = threading.Event()
        timer = threading.Timer(0.5, begin)
        timer.start()
        with KukaRsi("arm", "", options) as robot:
            timer.join()
            mover = threading.Thread(target=move_to_and_fro, args=(robot, ended))
            mover.start()
            try:
                yield child("mbcacq_kuka.rsi.cycle")
            finally:
                ended.set()
                mover.join()

    return program


def move_to_and_fro(robot: KukaRsi, ended: threading.Event) -> None:
    k = 0
    try:
        while not ended.is_set():
            robot.move_to(np.radians(HOME_DEG + [20.0 * (k % 2), 5.0 * (k % 3), 0.0, 30.0 * (k % 2), 0.0, 0.0]), MOTION)
            while not robot.state().arrived and not ended.wait(0.003):
                pass
            robot.cycles()
            k += 1
    except MbcacqError:
        ended.wait()  # the controller has ended: silence


LOADS = {  # what the other programs run, and what they do
    "none": ("", "none of ours"),
    "scans": (LOAD, "decoding scans and logging to rerun"),
    "compute": (COMPUTES, "programs that compute"),
    "memory": (COPIES, "programs that go through memory"),
}


@contextmanager
def busy_programs(load: str, count: int) -> Iterator[None]:
    code, _ = LOADS[load]
    count = {"none": 0, "scans": 1}.get(load, count)
    running = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(count)]
    try:
        for program in running:
            assert program.stdout is not None  # a pipe
            program.stdout.readline()
        yield
    finally:
        for program in running:
            program.kill()
            program.communicate()


def report(found: dict[tuple[str, str], list[Heard]], busy: list[float], given: argparse.Namespace) -> str:
    """A page; busy: load averages of the computer meanwhile, which include whatever else it had to do."""
    how = (
        "One controller asked both in turn within each cycle. 'Alone': missed cycles within 50 ms of which the other program missed "
        "none, so that the machine did not stand."
        if given.together
        else "The programs took turns."
    )
    lines = [
        "# Reply latency of the RSI cycle",
        "",
        f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, loopback, 4 ms by the clock; from sending a "
        f"telegram to having the answer, at the controller's side, us. {how} 'Missed': cycles without an answer within 4 ms; 'processor': "
        f"processor time a cycle, of the process that answers. Load average meanwhile: {min(busy):.0f} to {max(busy):.0f}. Made by "
        "`python benchmarks/rsi.py latency --write`.",
        "",
        "| other load | program | cycles | median | 99 % | 99.9 % | missed | alone | median / floor | processor |",
        "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    joined = {
        key: (np.concatenate([h.sent_s for h in heard]), np.concatenate([h.latency_us for h in heard])) for key, heard in found.items()
    }
    for (load, name), (sent_s, latency) in joined.items():
        answered, missed = latency[latency >= 0.0], latency < 0.0
        _, floor = joined[load, FLOOR]
        others = [other for key, other in joined.items() if key[0] == load and key[1] != name]
        alone = str(apart(sent_s[missed], others[0][0][others[0][1] < 0.0])) if given.together else "-"
        ratio = np.median(answered) / np.median(floor[floor >= 0.0])
        p50, p99, p999 = (np.percentile(answered, p) for p in (50, 99, 99.9))
        processor = 1e6 * sum(heard.processor_s for heard in found[load, name]) / len(latency)
        what = LOADS[load][1] if load in ("none", "scans") else f"{given.programs} {LOADS[load][1]}"
        lines.append(
            f"| {what} | {name} | {len(latency)} | {p50:.0f} | {p99:.0f} | {p999:.0f} "
            f"| {np.count_nonzero(missed)} | {alone} | {ratio:.2f} | {processor:.0f} |"
        )
    return "\n".join(lines) + "\n"


def apart(ours_s: np.ndarray, theirs_s: np.ndarray) -> int:
    """How many of these moments have none of those within STALL_S."""
    edges = np.concatenate([[-np.inf], theirs_s, [np.inf]])
    after = np.searchsorted(edges, ours_s)
    return int(np.count_nonzero(np.minimum(edges[after] - ours_s, ours_s - edges[after - 1]) >= STALL_S))


def free_ports(count: int) -> list[int]:
    with ExitStack() as open_ones:
        sockets = [open_ones.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for sock in sockets:
            sock.bind(("127.0.0.1", 0))
        return [sock.getsockname()[1] for sock in sockets]
