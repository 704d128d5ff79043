"""Runs that are disturbed while they go on: a fault at a system call, Ctrl-C at a terminal, two hours of runs with random faults.

    python benchmarks/disturbed_runs.py system-calls [--cases 200] [--seed 0] [--only CALL ...] [--cycle] [--clock] [--kept FILE]
    python benchmarks/disturbed_runs.py ctrl-c [--cases 60] [--seed 0] [--minutes M]
    unshare -m sh -c "mount -t tmpfs tmpfs /dev/shm; exec python benchmarks/disturbed_runs.py ctrl-c"     # shared memory of nobody else
    python benchmarks/disturbed_runs.py soak [--minutes 120] [--seed 0] [--chart soak.svg]

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import errno
import gc
import json
import os
import pty
import random
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bench
import yaml
from bench import MBCACQ, Kept, changed_plan, counted, curve, option, svg, table, text
from faults.preloaded import preload
from faults.small_run import CELL, CYCLE, NOISE_MM, DisturbedRuns, Fault, centres_of, three_poses

ERRNOS = {
    "open": ("EMFILE", "ENFILE", "EACCES", "ENOSPC", "EIO", "ENOMEM", "EINTR"),
    "read": ("EIO", "EINTR", "ENOMEM"),
    "write": ("ENOSPC", "EIO", "EDQUOT", "EINTR", "EPIPE"),
    "fsync": ("EIO", "ENOSPC", "EINTR"),
    "rename": ("EIO", "ENOSPC", "EACCES"),
    "unlink": ("EIO", "EACCES"),
    "mkdir": ("ENOSPC", "EACCES"),
    "stat": ("EIO", "EACCES", "ENOMEM"),
    "ftruncate": ("EIO", "ENOSPC"),
    "mmap": ("ENOMEM",),
    "alloc": ("ENOMEM",),
    "socket": ("EMFILE", "ENOBUFS", "EACCES"),
    "connect": ("ECONNREFUSED", "ETIMEDOUT", "ENETUNREACH", "EINTR"),
    "bind": ("EADDRINUSE", "EACCES"),
    "send": ("EPIPE", "ECONNRESET", "ENOBUFS", "ENETUNREACH", "EINTR"),
    "recv": ("ECONNRESET", "ENOMEM", "EINTR"),
    "poll": ("ENOMEM", "EINTR"),
    "pipe": ("EMFILE",),
}


CYCLE_CALLS = ("read", "write", "send", "recv", "poll", "mmap", "open", "socket", "bind")  # 400 of each are drawn from


def drawn_faults(runs: DisturbedRuns, rng: random.Random, only: list[str], cycle: bool):
    """Endless: one call after the other, n and errno drawn."""
    counts = dict.fromkeys(CYCLE_CALLS, 400) if cycle else runs.counts
    calls = [call for call in ERRNOS if call in only and counts.get(call)]
    while True:
        for call in calls:
            n, error = rng.randrange(counts[call]), rng.choice(ERRNOS[call])
            yield Fault(call, n, getattr(errno, error), CYCLE if cycle else "")


def clock_steps(runs: DisturbedRuns, cases: int) -> int:
    """The clock of the day jumps forwards and backwards at each pose."""
    from mbcacq.acquisition.events import PoseReached

    bad = 0
    for case in range(cases):
        step, at = (3600, -3600)[case % 2], case // 2 % len(runs.poses)

        def jump(event: object, step: int = step, at: int = at) -> None:
            if isinstance(event, PoseReached) and event.pose == at:
                runs.library.fault_clock(step)

        ending = runs.run(lambda: None, runs.work / f"clock{case}", False, [jump])
        bad += bool(ending.wrong) or ending.how != "goes on"
        print(f"clock {step:+} s at pose {at}: {ending.how} {ending.detail} {'; '.join(ending.wrong)}", flush=True)
    print(f"{cases} runs, {bad} not good")
    return bad


def print_table(cases: list[dict]) -> int:
    """Returns whether any case is not good."""
    table = Counter((case["call"], case["errno"], case["how"]) for case in cases)
    ways = sorted({how for *_, how in table})
    print("", *counted(table, ["call", "errno"], ways, lambda key: (list(ERRNOS).index(key[0]), key[1])), sep="\n")
    bad = sum(case["bad"] for case in cases)
    print(f"\n{len(cases)} cases, {bad} not good, {sum(case['seconds'] for case in cases):.0f} s")
    return 1 if bad else 0


def system_calls(given: argparse.Namespace) -> int:
    """A fault at a system call of a run: does it go on or end named, does the arm rest, can the folder be resumed?

    A run of three poses is repeated; in each repetition the n-th call of one function of the C library (open, write, fsync, ..., an
    allocation above 1 MiB) fails with one errno that it may have. Calls are taken in turn, n and errno are drawn with the seed.
    --cycle: in the process that answers the controller. --kept: every case is added to this file at once, those in it are not
    repeated. --clock: the clock of the day jumps by an hour in the middle, in place of faults. Linux, gcc.
    """
    runs, began = DisturbedRuns(preload()), time.monotonic()
    print("calls of an undisturbed run: " + ", ".join(f"{n} {call}" for call, n in runs.counts.items() if n), flush=True)
    if given.clock:
        return 1 if clock_steps(runs, given.cases) else 0
    kept = Kept(given.kept)
    for case, fault in enumerate(drawn_faults(runs, random.Random(given.seed), given.only, given.cycle)):
        if case >= given.cases or time.monotonic() - began > 60 * given.minutes:
            break
        if case < len(kept.rows):
            continue
        ending = runs.disturbed(fault, resume=case % 4 == 0)
        how = ending.how if ending.struck or fault.role or ending.how != "goes on" else "not reached"
        bad = bool(ending.wrong) or how == "foreign error"
        named = {"call": fault.call, "n": fault.n, "errno": errno.errorcode[fault.error]}
        result = {"how": how, "seconds": ending.seconds, "bad": bad}
        kept.add(named | result | {"detail": ending.detail, "wrong": ending.wrong})
        if bad or how.startswith("killed"):
            print(f"  {fault}: {how}: {ending.detail}; {'; '.join(ending.wrong)}", flush=True)
    runs.close()
    return print_table(kept.rows)


MOMENTS = ("start", "planning", "poses", "poses", "closing", "evaluation")
PAUSES_S = (0.0, 0.02, 0.3)  # between two presses of the key
LIMIT_S, REST_S = 240.0, 20.0
NOT_SAID = ("Traceback", "KeyboardInterrupt", "BufferError", "Exception ignored", "leaked", "a bug")
MARK = "CTRL_C_CASE"
EKI = {"address": "127.0.0.1", "port": 54600, "tool": 1, "base": 0, "mode": "any", "override": 100}


@dataclass
class Typed:
    """A command at a terminal of its own. text: what it showed; code: its exit code, minus the number of the signal that ended it."""

    arguments: list[str]
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)
    text: str = ""
    code: int | None = None

    def __post_init__(self) -> None:
        self._process, self._terminal = pty.fork()  # the terminal becomes the controlling one: Ctrl-C reaches the whole foreground
        if not self._process:
            os.execve(MBCACQ, [str(MBCACQ), *self.arguments], {**os.environ, MARK: self.mark, "TERM": "xterm", "COLUMNS": "200"})

    def listen(self, seconds: float) -> bool:
        """Read what it shows for so long; whether it still runs."""
        end = time.monotonic() + seconds
        while self.code is None:
            if select.select([self._terminal], [], [], max(0.0, min(0.01, end - time.monotonic())))[0]:
                try:
                    self.text += os.read(self._terminal, 65536).decode(errors="replace")
                except OSError:  # the other end is closed
                    time.sleep(0.005)
            done, status = os.waitpid(self._process, os.WNOHANG)
            if done:
                self.code = os.waitstatus_to_exitcode(status)
                os.close(self._terminal)
            elif time.monotonic() >= end:
                return True
        return False

    def wait_for(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + LIMIT_S
        while self.listen(0.0) and not condition() and time.monotonic() < end:
            pass

    def press_ctrl_c(self, times: int, rng: random.Random) -> None:
        for number in range(times):
            if number and not self.listen(rng.choice(PAUSES_S)) or self.code is not None:
                return
            os.write(self._terminal, b"\x03")

    def kill(self) -> None:
        if self.code is None:
            os.kill(self._process, signal.SIGKILL)


def plan_file(folder: Path, driver: str) -> Path:
    """The quick plan, its robot over RSI or EKI."""
    over_eki = {"driver": "kuka_eki", "options": EKI} if driver == "eki" else {}
    return changed_plan("quick.yaml", folder / f"{driver}.yaml", lambda plan: plan["robot"].update(over_eki))


def events(run: Path) -> list[dict[str, Any]]:
    try:
        return [json.loads(line) for line in (run / "journal.jsonl").read_text().splitlines()]
    except (OSError, ValueError):  # not there yet; a line that is being written
        return []


def wait_for_moment(typed: Typed, moment: str, run: Path, rng: random.Random) -> None:
    if moment == "start":
        typed.listen(rng.uniform(0.0, 0.5))
    elif moment == "planning":
        typed.wait_for(lambda: "checking" in typed.text or run.exists())
        typed.listen(rng.uniform(0.0, 1.0))
    else:
        poses = 10 if moment != "poses" else rng.randrange(10)
        typed.wait_for(lambda: sum(e["event"] == "pose_done" for e in events(run)) >= poses)
        if moment == "evaluation":
            typed.wait_for(lambda: any(e["event"] == "run_stopped" for e in events(run)))
        typed.listen(rng.uniform(0.0, {"poses": 0.5, "closing": 0.3, "evaluation": 5.0}[moment]))


def left_processes(mark: str) -> list[str]:
    """Command lines of processes that the case started."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (process / "environ").read_bytes() and b"State:\tZ" not in (process / "status").read_bytes():
                found.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:
            continue
    return found


def faults_of(typed: Typed, run: Path, shared: set[str], moment: str) -> list[str]:
    out = []
    ended_before = moment == "evaluation" and (run / "report.html").exists() and typed.code == 0
    if typed.code != 130 and not ended_before:
        out.append(f"exit code {typed.code}")
    out += [f"it printed '{word}'" for word in NOT_SAID if word in typed.text]
    end = time.monotonic() + REST_S
    while (processes := left_processes(typed.mark)) and time.monotonic() < end:
        time.sleep(0.2)
    out += [f"a process is left: {line}" for line in processes]
    out += [f"shared memory is left: {name}" for name in set(os.listdir("/dev/shm")) - shared]
    return out


def before_our_first_line(typed: Typed) -> bool:
    """Whether the key came while the interpreter itself started, where no program has a say."""
    return typed.code not in (None, 0, 130) and not any(word in typed.text for word in ("mbcacq: ", "in main", "cli/app.py"))


def resumed(command: list[str], run: Path) -> list[str]:
    """Go on to the end, without a terminal."""
    given = ["--resume", run] if (run / "run.rrd").exists() else ["--out", run.with_name("anew")]
    done = subprocess.run([MBCACQ, *command, *given], capture_output=True, text=True, timeout=LIMIT_S)
    return [] if done.returncode == 0 else [f"resumed: exit code {done.returncode}: {done.stderr[-300:]}"]


def where(run: Path) -> str:
    """What the run had come to when it ended, as its folder says."""
    seen = [e["event"] for e in events(run)]
    if not seen:
        return "before the recording"
    if any(e["event"] == "run_stopped" and e["exit_status"] == "success" for e in events(run)):
        return "calibration and report"
    return "poses" if "pose_done" in seen else "connecting, first pose"


@contextmanager
def cell_of(plan: Path, work: Path) -> Iterator[tuple[Path, Any]]:
    """A fake cell of our own, and the plan with its addresses."""
    from mbcacq.devices import load_driver
    from mbcacq.plan import expand, load

    loaded = load(plan)
    with load_driver("fakes", "cell")(loaded, expand(loaded), realtime=False) as cell:
        content = yaml.safe_load(plan.read_text())
        for role, options in cell.overrides().items():
            if role in content:
                content[role]["options"] = {**(content[role].get("options") or {}), **options}
        path = work / "addressed.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        yield path, cell.arm


def one_case(driver: str, moment: str, times: int, resume: bool, work: Path, rng: random.Random) -> tuple[Typed, str, list[str]]:
    """What was typed, what the run had come to, and what must not be."""
    run, plan = work / "run", plan_file(work, driver)
    with ExitStack() as held:
        command, arm = ["run", str(plan), "--dry-run"], None
        if moment in ("poses", "closing"):
            path, arm = held.enter_context(cell_of(plan, work))
            command = ["run", str(path), "--yes"]
        shared = set(os.listdir("/dev/shm"))
        typed = Typed([*command, "--out", str(run)])
        wait_for_moment(typed, moment, run, rng)
        typed.press_ctrl_c(times, rng)
        hangs = typed.listen(LIMIT_S)
        moving = arm is not None and not arm.read().standstill
        if before_our_first_line(typed):
            return typed, "the start of Python", []
        found = ["it hangs"] if hangs else faults_of(typed, run, shared, moment)
        found += ["the arm moves"] * moving
        typed.kill()
        if not found and resume:
            found = resumed(command, run)
    return typed, where(run) if typed.code == 130 else "ended before" if typed.code == 0 else "not good", found


def ctrl_c(given: argparse.Namespace) -> int:
    """Ctrl-C at a terminal, once to three times, at drawn moments of a whole run: how it ends, and what it leaves behind.

    Each case types ``mbcacq run PLAN`` at a pseudo-terminal of its own and presses the key there, so that the kernel sends the signal
    to every process of the foreground, as at a desk. The robot is driven by RSI and EKI in turn. The moments: while the program
    starts, while it plans, while the arm moves and scans, while it closes, calibrates and writes the report. While the arm may move,
    the fake cell is one of our own, whose arm is looked at when the command has ended; else it is that of ``--dry-run``. Afterwards
    there must be: exit code 130 (0 where the run had ended), no stack trace, no process, no shared memory, an arm at rest, a folder
    with which ``--resume`` goes on; every third is resumed to its end. Linux.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what is started in the background ignores the key, and so would its children
    rng, table, bad, began = random.Random(given.seed), Counter(), 0, time.monotonic()
    work = Path(tempfile.mkdtemp(prefix="ctrl-c-"))
    for case in range(given.cases):
        if time.monotonic() - began > 60 * given.minutes:
            break
        driver, moment, times = ("rsi", "eki")[case % 2], MOMENTS[case // 2 % len(MOMENTS)], 1 + rng.randrange(3)
        typed, came_to, found = one_case(driver, moment, times, case % 3 == 0, work, rng)
        table[came_to, driver, times] += 1
        print(f"{case} {driver} {moment} x{times}: code {typed.code}, {came_to}; {'; '.join(found) or 'good'}", flush=True)
        if found:
            bad += 1
            print(typed.text[-2000:], flush=True)
        for folder in (work / "run", work / "anew"):
            shutil.rmtree(folder, ignore_errors=True)
    shutil.rmtree(work)
    print("", *counted(table, ["pressed during", "driver"], (1, 2, 3)), sep="\n")
    print(f"\n{sum(table.values())} cases, {bad} not good")
    return 1 if bad else 0


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
    controller or scanner, or an interruption. What every run measured is compared with the first. Linux.
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


if __name__ == "__main__":
    SEED = option("--seed", type=int, default=0)
    MINUTES = option("--minutes", type=float, default=1e9, help="begin no further case after this time")
    CALLS = [
        option("--cases", type=int, default=200),
        option("--only", nargs="+", choices=list(ERRNOS), default=list(ERRNOS)),
        option("--cycle", action="store_true"),
        option("--clock", action="store_true"),
        option("--kept", type=Path),
    ]
    HOURS = [option("--minutes", type=float, default=120.0), SEED, option("--chart", type=Path, default=Path("soak.svg"))]
    commands = {
        "system-calls": (system_calls, [*CALLS, SEED, MINUTES]),
        "ctrl-c": (ctrl_c, [option("--cases", type=int, default=60), SEED, MINUTES]),
        "soak": (soak, HOURS),
    }
    sys.exit(bench.main(__doc__, commands))
