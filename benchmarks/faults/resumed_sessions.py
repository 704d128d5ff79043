"""Commands that record a session and can go on with it: ``collect`` and ``investigate``.

After each strike the session is resumed, or begun anew where nothing can be resumed. Its content must then be that of the undisturbed one,
bit for bit.
"""

from __future__ import annotations

import ctypes
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bench import TESTS

from faults.preloaded import Work, command, in_child
from faults.small_run import differences
from faults.strikes import Files, Struck

sys.path[:0] = [str(TESTS / "collect"), str(TESTS / "adaptive")]

ENDED = ("result.json", "report.html")


@dataclass(frozen=True, kw_only=True)
class Session:
    """begin, resume: the command that makes, or goes on with, a folder. begun: the file without which there is nothing to resume.

    prepare: makes what the command reads. strikes: real runs of each kind; moments: at most so many of the replay. Each is a session.
    """

    begin: Callable[[Path], Work]
    resume: Callable[[Path], Work]
    begun: str
    prepare: Callable[[], object]
    strikes: int
    moments: int


def sessions(work: Path) -> dict[str, Session]:
    """The commands by name; both work on cells whose noise depends on the pose alone."""
    place = work / "sessions"
    collect, clouds, cell = place / "collect" / "plan.yaml", place / "clouds", place / "cell" / "plan.yaml"

    def make_clouds() -> None:
        from session import play, program_of, written_plan

        collect.parent.mkdir(parents=True, exist_ok=True)
        plan = written_plan(collect.parent)
        play(plan, program_of(plan, place / "program"), clouds)

    def make_plan() -> None:
        from simulated_cell import simulated_plan

        cell.parent.mkdir(parents=True, exist_ok=True)
        simulated_plan(cell.parent, "concealed.yaml")

    return {
        "collect": Session(
            begin=lambda run: command("collect", collect, "--clouds", clouds, "--out", run),
            resume=lambda run: command("collect", collect, "--clouds", clouds, "--resume", run),
            begun="plan.yaml",
            prepare=make_clouds,
            strikes=6,
            moments=10,
        ),
        "investigate": Session(
            begin=lambda run: command("investigate", cell, "--dry-run", "--poses", 30, "--out", run),
            resume=lambda run: command("investigate", "--dry-run", "--resume", run),
            begun="investigation.json",
            prepare=make_plan,
            strikes=3,
            moments=4,
        ),
    }


class ResumedSession(Struck):
    """A session in the folder ``run`` below the one that is struck."""

    in_any_order = True

    def __init__(self, name: str, case: Session, work: Path, library: ctypes.CDLL) -> None:
        # Imported before the forks: each of the many children would do it again.
        import mbcacq.recording.rrd.writer
        import mbcacq.report
        import mbcacq.spheres.extract
        import mbcacq.workflow.collect
        import mbcacq.workflow.investigate  # noqa: F401
        from mbcacq.recording import load_observations

        super().__init__(name, work, library, case.moments, (case.strikes, case.strikes))
        self._case, self._run = case, self.folder / "run"
        if code := in_child(case.prepare):
            raise SystemExit(f"{name}: exit code {code} while its cell is made")
        self.record()
        self._whole = load_observations(self._run)

    def fresh(self) -> Files:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        return {}

    def begin(self) -> Work:
        return self._case.begin(self._run)

    def judged(self, code: int | None) -> str:
        """'new': resumed to what the undisturbed session holds; 'old': nothing had begun, and it was begun anew."""
        run, case = self._run, self._case
        begun = (run / case.begun).exists()
        if not begun:
            shutil.rmtree(run, ignore_errors=True)
        ended = all((run / name).exists() for name in ENDED)  # then there is nothing to resume
        again = 0 if ended else in_child(case.resume(run) if begun else self.begin())
        if again:
            return f"neither: {'resumed' if begun else 'begun anew'} with exit {again}"
        wrong = next(differences(run, self._whole), "") or next((f"no {name}" for name in ENDED if not (run / name).exists()), "")
        return f"neither: {wrong}" if wrong else "new" if begun else "old"
