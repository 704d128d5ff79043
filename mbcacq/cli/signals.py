"""A closed terminal, ``kill`` and Ctrl-C end a command in order, with nothing left behind, however often they come."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from collections.abc import Iterable
from types import FrameType
from typing import Any

from mbcacq.errors import Aborted

PATIENCE_S = 30.0  # a signal that comes so long after the first counts again: something hangs that should have closed
AGAIN_S = 0.05  # until it is tried again where an exception would have been lost


class FirstSignal:
    """Handler of which the first signal counts: KeyboardInterrupt at SIGINT, Aborted at others, in the main thread.

    Later ones must not disturb the closing, in which the arm comes to rest and the recording is completed; all of it is bounded in time. A
    raised error may get lost: an extension that is being imported makes another error of it, a finaliser drops it. It is therefore raised
    after an import, and once more where it was dropped. what: subject of the sentence of Aborted.
    """

    def __init__(self, what: str) -> None:
        self._what, self._since, self._number = what, 0.0, 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self._number and time.monotonic() - self._since < PATIENCE_S:
            return
        if _importing(frame):
            _raise_again(number)
            return
        self._number, self._since = number, time.monotonic()
        raise self._error()

    def handle(self, numbers: Iterable[int]) -> None:
        """Take the place of the handlers of these signals, but for those that ignore them: nohup stays nohup. Ctrl-C counts in any case
        where the keyboard is ours."""
        for number in numbers:
            before = signal.getsignal(number)
            if before is signal.SIG_IGN and number == signal.SIGINT and at_the_keyboard():
                before = signal.SIG_DFL  # inherited from a shell; who sits there must be able to stop an arm
            if before in (signal.SIG_DFL, signal.default_int_handler) or isinstance(before, FirstSignal):
                signal.signal(number, self)
        if not isinstance(sys.unraisablehook, _Unraisable):
            sys.unraisablehook = _Unraisable(sys.unraisablehook)
        sys.unraisablehook.first = self

    def came(self) -> BaseException | None:
        """The exception of the first signal, whatever it was turned into on its way."""
        return self._error() if self._number else None

    def dropped(self, error: BaseException | None) -> bool:
        """Whether this is what was raised; it will then be raised once more."""
        if not self._number or not isinstance(error, type(self._error())):
            return False
        number, self._number = self._number, 0
        _raise_again(number)
        return True

    def _error(self) -> BaseException:
        if self._number == signal.SIGINT:
            return KeyboardInterrupt()
        return Aborted(f"{self._what} was ended by {signal.Signals(self._number).name}")


def at_the_keyboard() -> bool:
    """Whether standard input is a terminal of which this process is in the foreground."""
    try:
        return sys.stdin.isatty() and (not hasattr(os, "tcgetpgrp") or os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp())
    except (AttributeError, OSError, ValueError):
        return False


class _Unraisable:
    """Hook for errors that nobody can catch: in finalisers and callbacks."""

    def __init__(self, other: Any) -> None:
        self.first: FirstSignal | None = None
        self._other = other

    def __call__(self, unraisable: Any) -> None:
        if self.first is None or not self.first.dropped(unraisable.exc_value):
            self._other(unraisable)


def interrupt_once() -> None:
    """Raise KeyboardInterrupt at the first Ctrl-C only. Programs that are started in the background stay deaf to it."""
    FirstSignal("the command").handle([signal.SIGINT])


def end_in_order_on_signals(what: str = "the run") -> None:
    """Raise Aborted in the main thread at SIGTERM and SIGHUP, KeyboardInterrupt at SIGINT, once. what: subject of the sentence."""
    FirstSignal(what).handle(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def ended_by_signal() -> BaseException | None:
    """The exception of the first signal, if one has come."""
    handler = signal.getsignal(signal.SIGINT)
    return handler.came() if isinstance(handler, FirstSignal) else None


def _importing(frame: FrameType | None) -> bool:
    while frame is not None and frame.f_globals.get("__name__") != "mbcacq.cli":  # what imported the command itself does not count
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _raise_again(number: int) -> None:
    """A bare thread: threading.Thread takes a lock that the interrupted code may hold."""
    _thread.start_new_thread(_after_a_moment, (number,))


def _after_a_moment(number: int) -> None:
    time.sleep(AGAIN_S)
    if hasattr(signal, "pthread_kill"):
        main = threading.main_thread().ident
        assert main is not None  # it runs
        signal.pthread_kill(main, number)  # ends a system call that it waits in, too
    else:
        _thread.interrupt_main(signal.Signals(number))
