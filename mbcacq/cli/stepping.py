"""``--step``: a key before each pose."""

from __future__ import annotations

import select
import sys
import threading

from mbcacq.cli.terminal import echo
from mbcacq.errors import Aborted, ConfigError
from mbcacq.plan import PlannedPose

POLL_S = 0.1


class KeyPause:
    """Waits for Enter on the terminal; 'q' ends the run, 'g' goes on without further questions."""

    def __init__(self) -> None:
        """Raises ConfigError where nobody can press a key."""
        if sys.stdin is None or sys.stdin.closed or not sys.stdin.isatty():
            raise ConfigError("--step waits for a key before each pose, but standard input is not a terminal; leave it out or use one")
        self._stopped, self._free = threading.Event(), False

    def wait(self, pose: PlannedPose, n_poses: int) -> None:
        if self._free:
            return
        where = f"pose {pose.number} ({pose.step_name}, station {pose.station}; the last is pose {n_poses - 1})"
        echo(f"next: {where}; Enter moves, g goes on without asking, q ends the run: ", err=True, nl=False)
        answer = self._answer()
        if answer is None or answer.strip().lower() in ("q", "quit"):
            raise Aborted(f"the operator ended the run before pose {pose.number}")
        self._free = answer.strip().lower() in ("g", "go")

    def stop(self) -> None:
        self._stopped.set()

    def _answer(self) -> str | None:
        """The line typed; None at the end of input or after ``stop``."""
        while not self._stopped.is_set():
            try:
                ready = bool(select.select([sys.stdin], [], [], POLL_S)[0])
            except (OSError, ValueError):  # where a terminal cannot be polled (Windows), wait for the line itself
                ready = True
            if ready:
                return sys.stdin.readline() or None
        return None
