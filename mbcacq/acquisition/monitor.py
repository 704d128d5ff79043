"""Monitors the arm while the run waits for something else: an operator, a positioner, a scanner that starts again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from mbcacq.devices import Robot

PERIOD_S = 0.05


class RobotMonitor:
    """Context manager around a wait. A thread calls ``interrupt`` as soon as the robot reports a stop, so that the wait ends. The robot's
    error is then raised instead of the one that the interrupted wait raised."""

    def __init__(self, robot: Robot, interrupt: Callable[[], None]) -> None:
        self._robot, self._interrupt = robot, interrupt
        self._quit = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="robot-monitor", daemon=True)

    @property
    def error(self) -> Exception | None:
        """What stopped the robot, if anything did."""
        return self._error

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._quit.set()
        self._thread.join()
        if self._error is not None and (kind is None or issubclass(kind, Exception)):
            raise self._error

    def _work(self) -> None:
        while not self._quit.wait(PERIOD_S):
            try:
                self._robot.state()
            except Exception as error:
                self._error = error
                self._interrupt()
                return
