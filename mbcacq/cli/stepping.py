"""``--step``: a key before each pose."""

from __future__ import annotations

import threading

from mbcacq.cli.terminal import echo
from mbcacq.devices import is_interactive, typed_line
from mbcacq.errors import Aborted, ConfigError
from mbcacq.plan import PlannedPose


class KeyPause:
    """Waits for Enter on the terminal; 'q' ends the run, 'g' goes on without further questions."""

    def __init__(self) -> None:
        """Raises ConfigError if nobody can press a key."""
        if not is_interactive():
            raise ConfigError("--step waits for a key before each pose, but standard input is not a terminal; use one, or leave --step out")
        self._stopped, self._free = threading.Event(), False

    def wait(self, pose: PlannedPose, n_poses: int) -> None:
        if self._free:
            return
        where = f"pose {pose.number} ({pose.step_name}, station {pose.station}; the last is pose {n_poses - 1})"
        echo(f"next: {where}; Enter moves, g goes on without asking, q ends the run: ", err=True, nl=False)
        answer = typed_line(self._stopped)
        if answer is None or answer.strip().lower() in ("q", "quit"):
            raise Aborted(f"the operator ended the run before pose {pose.number}")
        self._free = answer.strip().lower() in ("g", "go")

    def stop(self) -> None:
        self._stopped.set()
