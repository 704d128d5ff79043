"""Runs of a small plan in processes of their own, disturbed by ``system_call_faults.c``: how each ended, and what it left behind.

The program under test is forked from one that has
everything imported; the fake cell is another process and is never disturbed.
"""

from __future__ import annotations

import ctypes
import errno
import json
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench import changed_plan

SAME_Q = 1e-12  # rad; the mean over another number of equal cycles differs in its last bits
LIMIT_S, REST_S, NOISE_MM = 240.0, 60.0, 0.15  # on a machine that is busy with other work too
CYCLE = "mbcacq_kuka.rsi.cycle"  # the command line of the process that answers the controller
CELL = "the fake cell of seed 3"


@dataclass(frozen=True)
class Fault:
    """The n-th call (from 0) fails with this errno. role: in the process whose command line holds it, by default the run itself."""

    call: str
    n: int
    error: int
    role: str = ""

    def __str__(self) -> str:
        where = " of the RSI process" if self.role else ""
        return f"{self.call} number {self.n}{where}: {errno.errorcode.get(self.error, self.error)}"


@dataclass
class Ending:
    """how: 'goes on', 'ends named', 'foreign error', 'killed by signal N', 'hangs'. wrong: what must not be, in words."""

    how: str
    detail: str = ""
    struck: bool = False
    seconds: float = 0.0
    counts: dict[str, int] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)


def three_poses(folder: Path) -> Path:
    """Three poses of the quick plan, one exposure each."""

    def change(plan: dict[str, Any]) -> None:
        plan["exposures"] = 1
        plan["steps"] = plan["steps"][1:]
        plan["steps"][0]["views"] = plan["steps"][0]["views"][:3]

    return changed_plan("quick.yaml", folder / "three.yaml", change)


def two_stations(folder: Path) -> Path:
    """Sixteen poses: the quick plan with a second station, its noise drawn by pose, so that two runs can be compared number by number."""

    def change(plan: dict[str, Any]) -> None:
        plan["stations"].append({"id": "p2", "artefact": "mbc", "pose_in_base": {"translation_mm": [560, 160, 120], "abc_deg": [20, 0, 0]}})
        plan["steps"][1]["stations"] = ["p1", "p2"]
        plan["exposures"] = 3
        still = {"encoder_noise_deg": 0.0, "encoder_step_deg": 0.0}  # a mean over another number of cycles is the same
        plan["fake"] = {"draws": "pose", "robot": still}

    return changed_plan("quick.yaml", folder / "plan.yaml", change)


class DisturbedRuns:
    """A small plan, checked once, and the centres of its undisturbed run."""

    def __init__(self, library: ctypes.CDLL) -> None:
        import mbcacq.recording.rrd.writer  # noqa: F401  (imported before the fork, so that imports are not among the calls)
        import mbcacq.recording.run_folder.progress  # noqa: F401
        import mbcacq.recording.run_folder.recovery  # noqa: F401
        import mbcacq.recording.run_folder.run_plan  # noqa: F401
        import mbcacq.spheres.extract  # noqa: F401
        from mbcacq.plan import expand, load
        from mbcacq.workflow import acquire

        self.library = library
        self.work = Path(tempfile.mkdtemp(prefix="disturbed-"))
        self.loaded = load(three_poses(self.work))
        self.poses = expand(self.loaded)
        self.acquisition = acquire.plan_acquisition(self.loaded, self.poses, frozenset(), 0, CELL)
        self.centres: dict[tuple[int, int], Any] = {}
        whole = self.run(lambda: None, self.work / "undisturbed", resume=False)
        assert whole.how == "goes on", whole
        self.counts = whole.counts
        self.centres = centres_of(self.work / "undisturbed")

    def close(self) -> None:
        shutil.rmtree(self.work, ignore_errors=True)

    def disturbed(self, fault: Fault, resume: bool) -> Ending:
        """One run with one fault."""
        folder = self.work / "run"
        shutil.rmtree(folder, ignore_errors=True)
        return self.run(lambda: self.arm(fault), folder, resume)

    def arm(self, fault: Fault) -> None:
        if fault.role:
            os.environ |= {"FAULT_ARM": f"{fault.call}:{fault.n}:{fault.error}", "FAULT_ROLE": fault.role}
        else:
            self.library.fault_arm(fault.call.encode(), fault.n, fault.error)

    def run(self, prepare: Callable[[], object], folder: Path, resume: bool, subscribers: Sequence[Any] = ()) -> Ending:
        """Fork a process that owns the fake cell and forks the run; ``prepare`` is called in the latter. resume: go on with the folder
        afterwards, undisturbed, to the end."""
        written = self.work / "ending.json"
        written.unlink(missing_ok=True)
        keeper = os.fork()
        if not keeper:
            os.setsid()
            status = 1
            try:
                ending = self._in_a_cell(prepare, folder, resume, subscribers)
                written.write_text(json.dumps(ending.__dict__))
                status = 0
            finally:
                os._exit(status)
        os.waitpid(keeper, 0)
        try:
            os.killpg(keeper, signal.SIGKILL)  # whatever is left of its session
        except ProcessLookupError:
            pass
        if not written.exists():
            return Ending("hangs", wrong=["the process that keeps the cell failed"])
        return Ending(**json.loads(written.read_text()))

    def _in_a_cell(self, prepare: Callable[[], object], folder: Path, resume: bool, subscribers: Sequence[Any]) -> Ending:
        from mbcacq.devices import load_driver

        with load_driver("fakes", "cell")(self.loaded, self.poses, realtime=False, seed=3) as fake:
            began = time.monotonic()
            ending = self._forked(prepare, folder, fake.overrides(), subscribers)
            ending.seconds = time.monotonic() - began
            if not _eventually(lambda: bool(fake.arm.read().standstill), REST_S):
                ending.wrong.append("the arm did not come to rest")
        ending.wrong += self.left_behind(folder, ending)
        if resume and not ending.wrong:
            ending.wrong += self.resumed(folder)
        return ending

    def _forked(self, prepare: Callable[[], object], folder: Path, overrides: Any, subscribers: Sequence[Any]) -> Ending:
        written = self.work / "run.json"
        written.unlink(missing_ok=True)
        run = os.fork()
        if not run:
            try:
                os.dup2(os.open(self.work / "output", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
                self._execute(prepare, folder, overrides, subscribers, written)
            finally:
                os._exit(3)
        status = _wait(run, LIMIT_S)
        if status is None:
            os.kill(run, signal.SIGKILL)
            os.waitpid(run, 0)
            return Ending("hangs", "", True, wrong=["the run hangs"])
        if os.WIFSIGNALED(status):
            return Ending(f"killed by signal {os.WTERMSIG(status)}", _tail(self.work / "output"), True)
        return Ending(**json.loads(written.read_text())) if written.exists() else Ending("foreign error", _tail(self.work / "output"), True)

    def _execute(self, prepare: Callable[[], object], folder: Path, overrides: Any, subscribers: Sequence[Any], written: Path) -> None:
        from mbcacq.cli.app import refused_by_the_system
        from mbcacq.errors import MbcacqError
        from mbcacq.recording.run_folder.lock import write_lock
        from mbcacq.workflow.acquire import new_run_folder

        how, detail, library = "goes on", "", self.library
        library.fault_arm(b"none", -1, 0)
        prepare()
        try:
            new_run_folder(folder, "small")
            with write_lock(folder, "run"):
                self.acquisition.folder, self.acquisition.simulated = folder, True
                self.acquisition.execute(overrides, subscribers)
        except MbcacqError as error:
            how, detail = "ends named", f"{type(error).__name__}: {error}"
        except Exception as error:
            how = "ends named" if refused_by_the_system(error) else "foreign error"
            detail = f"{type(error).__name__}: {error}"
            if how == "foreign error":
                import traceback

                place = traceback.extract_tb(error.__traceback__)[-1]
                detail += f" at {Path(place.filename).name}:{place.lineno}"
        struck = bool(library.fault_disarm())
        counts = {library.fault_name(k).decode(): library.fault_count(k) for k in range(32) if library.fault_name(k)}
        written.write_text(json.dumps({"how": how, "detail": detail[:600], "struck": struck, "counts": counts}))
        os._exit(0)

    def left_behind(self, folder: Path, ending: Ending) -> list[str]:
        """What the recording holds that is not so, in words; whether the run could be resumed."""
        import numpy as np

        from mbcacq.errors import MbcacqError
        from mbcacq.workflow.resume import progress_before

        if not folder.exists() or not any(folder.glob("plan.yaml")):
            return []  # it began not: there is nothing to go on with
        try:
            progress = progress_before(folder, self.loaded, CELL, str)
            found = centres_of(folder) if progress.done else {}
        except MbcacqError as error:
            return [f"not resumable: {error}"]
        except Exception as error:
            return [f"not resumable: {type(error).__name__}: {error}"]
        out = [] if not self.centres or all(key in self.centres for key in found) else ["balls that the undisturbed run does not have"]
        if self.centres and any(np.abs(xyz - self.centres[key]).max() > NOISE_MM for key, xyz in found.items() if key in self.centres):
            out.append("wrong centres")
        if self.centres and ending.how == "goes on" and {pose for pose, _ in found} != {pose for pose, _ in self.centres}:
            out.append("the run ended well without some of its poses")
        return out

    def resumed(self, folder: Path) -> list[str]:
        """Go on with the folder to the end, undisturbed."""
        from mbcacq.devices import load_driver
        from mbcacq.workflow import acquire
        from mbcacq.workflow.resume import progress_before

        if not any(folder.glob("plan.yaml")):
            return []  # it began not
        try:
            before = progress_before(folder, self.loaded, CELL, str)
            if all(pose.number in before.done for pose in self.poses):
                return []
            rest = acquire.plan_acquisition(self.loaded, self.poses, before.done, before.part, CELL)
            rest.folder, rest.simulated = folder, True
            with load_driver("fakes", "cell")(self.loaded, self.poses, realtime=False, seed=3) as fake:
                rest.execute(fake.overrides())
            found = centres_of(folder)
        except Exception as error:
            return [f"resumed: {type(error).__name__}: {error}"]
        whole = {pose.number for pose in self.poses}
        return [] if {pose for pose, _ in found} == whole else ["poses are missing after the run was resumed"]


def centres_of(folder: Path) -> dict[tuple[int, int], Any]:
    """(pose, ball) -> (3,) mm."""
    from mbcacq.recording import load_observations

    recorded = load_observations(folder)
    ids, balls = recorded.pose_id, recorded.cell.ball_ids
    return {(int(ids[p]), int(balls[b])): xyz for p, b, xyz in zip(recorded.pose, recorded.ball, recorded.xyz, strict=True)}


def compare(folder: Path, whole) -> str:
    """'' if the observations of a run folder are those of the undisturbed run, else the first thing that differs."""
    return next(differences(folder, whole), "")


def differences(folder: Path, whole) -> Iterator[str]:
    """What differs between a run folder and the undisturbed run, in words; nothing more once poses or balls are others."""
    import numpy as np

    from mbcacq.recording import load_observations

    found = load_observations(folder)
    if sorted(found.pose_id.tolist()) != whole.pose_id.tolist():
        yield f"poses {sorted(found.pose_id.tolist())}"
        return
    order = np.argsort(found.pose_id)
    rank = np.argsort(order)
    rows = np.lexsort((np.arange(found.n_centres), rank[found.pose]))
    if not np.array_equal(found.ball[rows], whole.ball):
        yield "other balls"
        return
    if not np.array_equal(found.xyz[rows], whole.xyz):
        yield f"centres differ by up to {np.abs(found.xyz[rows] - whole.xyz).max():.2e} mm"
    if (away := np.abs(found.q[order] - whole.q).max()) > SAME_Q:
        yield f"joint angles differ by up to {away:.2e} rad"
    if not np.array_equal(found.direction[order], whole.direction):
        yield "the arm came from another side"
    merged = load_observations(folder / "whole.rrd") if (folder / "whole.rrd").exists() else found
    if not np.array_equal(merged.xyz, found.xyz) or not np.array_equal(merged.q, found.q):
        yield "the merged recording differs from its parts"


def _eventually(condition: Callable[[], bool], within_s: float) -> bool:
    deadline = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def _wait(process: int, within_s: float) -> int | None:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        done, status = os.waitpid(process, os.WNOHANG)
        if done:
            return status
        time.sleep(0.02)
    return None


def _tail(path: Path) -> str:
    try:
        return path.read_bytes()[-300:].decode(errors="replace").strip().replace("\n", " | ")
    except OSError:
        return ""
