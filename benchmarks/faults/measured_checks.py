"""``check``, which records its poses and adds its day to a history: measured anew where it was interrupted."""

from __future__ import annotations

import ctypes
import shutil
from pathlib import Path

from faults.command_inputs import finding_changes, measure_checks
from faults.preloaded import Work, command, in_child
from faults.strikes import Files, Struck

NAME = "check"


class MeasuredCheck(Struck):
    """The second check of a cell, which is another one than the calibrated; the history holds the first."""

    in_any_order = True

    def __init__(self, work: Path, library: ctypes.CDLL) -> None:
        import mbcacq.interim_check
        import mbcacq.recording.rrd.writer
        import mbcacq.spheres.extract  # noqa: F401  (before the forks)

        super().__init__(NAME, work, library, 12, (6, 6))
        self._work, self._history = work, self.folder / "history.json"
        measure_checks(work)
        first = self.folder / "first.json"
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        if code := in_child(self._check("--from", work / "check-a", "--history", first)):
            raise SystemExit(f"{NAME}: exit code {code} of the first")
        self._before = first.read_bytes()
        self.record()
        self._after = self._days()

    def fresh(self) -> Files:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        self._history.write_bytes(self._before)
        return {self._history.name: self._before}

    def begin(self) -> Work:
        return self._measured("run")

    def judged(self, code: int | None) -> str:
        """'new': the history has the day, and its recording is whole; 'old': it has not, and the check is measured anew to the same day."""
        from mbcacq.recording import load_observations

        old = self._history.read_bytes() == self._before
        if old and (again := in_child(self._measured("again"))):
            return f"neither: measured anew with exit {again}"
        if self._days() != self._after:
            return "neither: another day"
        if old:
            return "old"
        whole = sorted({pose for pose, _ in self._days()[-1]}) == sorted(load_observations(self.folder / "run").pose_id.tolist())
        return "new" if whole else "neither: a day without its recording"

    def _measured(self, name: str) -> Work:
        return self._check("--dry-run", "--seed", 1, "--history", self._history, "--out", self.folder / name)

    def _check(self, *how: object) -> Work:
        return finding_changes(command("check", self._work / "a.json", self._work / "check.yaml", *how))

    def _days(self) -> list[dict[tuple[int, int], tuple[float, ...]]]:
        """What each day of the history measured."""
        from mbcacq.interim_check.history import read_history

        history = read_history(self._history)
        assert history is not None
        return [{key: tuple(value) for key, value in day.residual.items()} for day in history.days]
