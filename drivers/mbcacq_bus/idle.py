"""Keeping an unused connection alive."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from mbcacq.devices import MbcacqError


class IdlePoll:
    """Asks something harmless of a connection that nobody has used for a while, in a thread of its own.

    Parameters
    ----------
    poll : Callable[[], object]
        Asks, and moves nothing. Its errors are left to the next request, which connects again or reports them.
    used : Callable[[], float]
        When the connection was last used, time.monotonic.
    after_s : float
        How long it may be idle, s; 0 for as long as it likes.
    """

    def __init__(self, poll: Callable[[], object], used: Callable[[], float], after_s: float) -> None:
        self._poll, self._used, self._after_s = poll, used, after_s
        self._quit = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        self.stop()
        if self._after_s > 0:
            self._quit = threading.Event()
            self._thread = threading.Thread(target=self._keep, args=(self._quit,), name="idle-poll", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Idempotent; does not wait for a question under way."""
        self._quit.set()
        self._thread = None

    def _keep(self, quit_: threading.Event) -> None:
        while not quit_.wait(max(self._used() + self._after_s - time.monotonic(), self._after_s / 10)):
            if time.monotonic() - self._used() < self._after_s:
                continue
            try:
                self._poll()
            except MbcacqError:
                quit_.wait(self._after_s)
