"""Strikes of ``command_strikes.py`` against the commands that record a run and can go on with it: ``collect`` and ``investigate``.

After each strike the session is resumed, or begun anew where nothing can be resumed. What it holds then must be what the undisturbed one
holds, bit for bit.
"""

from __future__ import annotations

import errno
import os
import random
import shutil
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from interrupted_runs import Disk, differences, records
from strike_commands import ROOT, Work, command

sys.path[:0] = [str(ROOT / "tests" / "collect"), str(ROOT / "tests" / "adaptive")]


@dataclass(frozen=True)
class Session:
    """begin, resume: the command that makes, or goes on with, a folder. begun: the file without which there is nothing to resume.
    prepare: makes what the command reads. strikes: real runs of each kind; moments: at most so many of the replay."""

    begin: Callable[[Path], Work]
    resume: Callable[[Path], Work]
    begun: str
    prepare: Callable[[], object]
    strikes: int
    moments: int


def sessions(work: Path) -> dict[str, Session]:
    """The commands by name; both work on cells whose noise depends on the pose alone."""
    place = work / "sessions"
    collect, clouds = place / "collect" / "plan.yaml", place / "clouds"

    def make_clouds() -> None:
        from session import play, program_of, written_plan

        collect.parent.mkdir(parents=True, exist_ok=True)
        plan = written_plan(collect.parent)
        play(plan, program_of(plan, place / "program"), clouds)

    def make_plan() -> None:
        from simulated_cell import simulated_plan

        (place / "cell").mkdir(parents=True, exist_ok=True)
        simulated_plan(place / "cell", "concealed.yaml")

    cell = place / "cell" / "plan.yaml"
    return {
        "collect": Session(
            lambda run: command("collect", collect, "--clouds", clouds, "--out", run),
            lambda run: command("collect", collect, "--clouds", clouds, "--resume", run),
            "plan.yaml",
            make_clouds,
            strikes=6,
            moments=5,
        ),
        "investigate": Session(
            lambda run: command("investigate", cell, "--dry-run", "--poses", 30, "--out", run),
            lambda run: command("investigate", "--dry-run", "--resume", run),
            "investigation.json",
            make_plan,
            strikes=1,
            moments=1,
        ),
    }


def strike_session(
    name: str, case: Session, work: Path, moments: Callable[[int, list], list[int]], run_in_child: Callable[[Work], int], tools: Any
) -> Counter:
    """Outcomes of one command by (kind of strike, exit, what stood there). tools: the library of faults, and what kills at an event."""
    # Imported before the forks: each of the many children would do it again.
    import mbcacq.recording.rrd.writer
    import mbcacq.report
    import mbcacq.spheres.extract
    import mbcacq.workflow.collect
    import mbcacq.workflow.investigate  # noqa: F401
    from mbcacq.recording import load_observations

    assert run_in_child(case.prepare) == 0, name
    folder, log = work / "out", work / "log"
    run = folder / "run"
    log.unlink(missing_ok=True)
    _empty(folder)

    def recorded() -> object:
        tools.library.fault_record(str(folder).encode(), str(log).encode())
        os.environ["FAULT_RECORD"] = f"{folder}|{log}"
        return case.begin(run)()

    code = run_in_child(recorded)
    assert code == 0, code
    found, whole = list(records(log.read_bytes())), load_observations(run)
    judge = partial(_judged, case, run, whole, run_in_child)
    out: Counter = Counter()
    disk, done = Disk(), 0
    for moment in sorted(moments(case.moments, found)):
        for record in found[done:moment]:
            disk.apply(record)
        done = moment
        states = {
            "kill, replayed": {path: bytes(file.content) for path, file in disk.names.items()},
            "power cut, lost": disk.after_cut(None),
            "power cut, some kept": disk.after_cut(tools.rng),
        }
        for kind, files in states.items():
            _empty(folder)
            for path, data in files.items():
                (folder / path).parent.mkdir(parents=True, exist_ok=True)
                (folder / path).write_bytes(data)
            _note(out, name, kind, "-", judge())
    count = work / "count"
    _empty(folder)
    assert run_in_child(tools.killed_at(1 << 60, folder, case.begin(run), count)) == 0, name
    events, writes = int(count.read_text()), sum(record.kind == "w" for record in found)
    for number in tools.rng.sample(range(1, events + 1), min(case.strikes, events)):
        _empty(folder)
        code = run_in_child(tools.killed_at(number, folder, case.begin(run)))
        _note(out, name, "kill", "killed" if code < 0 else code, judge())
    for write in sorted(tools.rng.sample(range(writes), min(case.strikes, writes))):
        _empty(folder)
        code = run_in_child(_full_at(tools.library, folder, write, case.begin(run)))
        _note(out, name, "full disk", code, "neither: foreign" if code in (1, 99) else judge())
    print(f"{name}: {len(found)} records, {writes} writes, {events} events", flush=True)
    return out


def _note(out: Counter, name: str, kind: str, code: object, found: str) -> None:
    """Count an outcome, and say it: each takes a while."""
    out[kind, code, found] += 1
    print(f"  {name}: {kind}, exit {code}: {found}", flush=True)


def _full_at(library: Any, folder: Path, write: int, begin: Work) -> Work:
    def work() -> object:
        library.fault_below(str(folder).encode())
        library.fault_arm(b"write", write, errno.ENOSPC)
        return begin()

    return work


def _judged(case: Session, run: Path, whole: Any, run_in_child: Callable[[Work], int]) -> str:
    """'new': resumed to what the undisturbed session holds; 'old': nothing had begun, and it was begun anew; 'neither' with the reason."""
    begun = (run / case.begun).exists()
    if not begun:
        shutil.rmtree(run, ignore_errors=True)
    code = run_in_child(case.resume(run) if begun else case.begin(run))
    if code:
        return f"neither: resumed with exit {code}" if begun else f"neither: begun anew with exit {code}"
    wrong = next(differences(run, whole), "") or next(
        (f"no {name}" for name in ("result.json", "report.html") if not (run / name).exists()), ""
    )
    return f"neither: {wrong}" if wrong else "new" if begun else "old"


def _empty(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()


@dataclass(frozen=True)
class Tools:
    """What strikes: the preloaded library, ``killed_at`` of ``command_strikes.py``, and the drawing of numbers."""

    library: Any
    killed_at: Callable[..., Work]
    rng: random.Random
