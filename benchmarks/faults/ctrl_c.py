"""Ctrl-C at a terminal, at drawn moments of a whole run."""

from __future__ import annotations

import argparse
import json
import os
import pty
import random
import select
import shutil
import signal
import subprocess
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from bench import MBCACQ, changed_plan, counted

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

    Each case types ``mbcacq run PLAN`` at a pseudo-terminal of its own and presses the key there, so that the kernel sends the signal to
    every process of the foreground, as at a desk. The robot is driven by RSI and EKI in turn. The moments: while the program starts, while
    it plans, while the arm moves and scans, while it closes, calibrates and writes the report. While the arm may move, the fake cell is one
    of our own, whose arm is looked at when the command has ended; else it is that of ``--dry-run``. Afterwards the exit code must be 130 (0
    where the run had ended), with no stack trace, no process, no shared memory, an arm at rest, and a folder with which ``--resume`` goes
    on. Every third run is resumed to its end. Linux.
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
