"""Progress of a command that computes: which step it is at, for how long, and how long it still takes; on stderr.

The clock is a timer signal, not a thread: a process that has threads cannot fork its workers safely.
"""

from __future__ import annotations

import re
import shutil
import signal
import sys
import threading
import time
from types import TracebackType

from mbcacq.cli.terminal import echo

EVERY_S = 1.5  # nothing is silent for more than two seconds
MOST_LINES = 10  # of counted parts, in a file or a pipe
COUNTED = re.compile(r"(\d+) of (\d+)$")


def shortened(text: str, columns: int) -> str:
    """The text, or its first words with an ellipsis if it is longer than so many columns."""
    if len(text) <= columns:
        return text
    cut = text[: columns - 1]
    return f"{cut.rpartition(' ')[0] or cut}…"


class StepProgress:
    """Call it with a sentence at the begin of each step; use it as a context. A sentence that ends with 'k of n' is counted: the time
    left is then estimated from the counts before it. On a terminal one line is written over; elsewhere each step is a line; every tenth of
    many counted ones has one. An empty sentence ends the steps: the terminal belongs to somebody else, and no signal comes. ``first`` is
    the step at which the context begins, named only when it takes long."""

    def __init__(self, first: str = "") -> None:
        self._first, self._terminal = first, sys.stderr.isatty()
        self._text, self._began, self._counting_since = "", 0.0, 0.0
        self._count: tuple[int, int] | None = None
        self._written = 0
        self._timed, self._said = False, False

    def __call__(self, text: str) -> None:
        self.begin(text)
        if text and (self._terminal or self._gets_a_line()):
            self._say(f"{text}{self._left(self._began)} ...")

    def printed(self, text: str) -> None:
        """A step that has a line of its own, which stays; the same step again has none."""
        if text != self._text:
            self.clear()
            echo(text, err=True)
        self.begin(text)
        self._said = True

    def begin(self, text: str) -> None:
        """A step whose begin is not worth a line: it is named only when it takes long."""
        now = time.monotonic()
        found = COUNTED.search(text)
        count = (int(found[1]), int(found[2])) if found else None
        if count is None or self._count is None or count[0] <= self._count[0]:
            self._counting_since = now
        if bool(text) != bool(self._text) and self._timed:
            self._tick_every(EVERY_S if text else 0.0)
        self._text, self._began, self._count, self._said = text, now, count, False
        if not text:
            self.clear()

    def __enter__(self) -> StepProgress:
        in_main = threading.current_thread() is threading.main_thread()
        free = hasattr(signal, "SIGALRM") and signal.getsignal(signal.SIGALRM) == signal.SIG_DFL  # else the alarm is somebody else's
        self._timed = free and in_main
        if self._timed:
            signal.signal(signal.SIGALRM, lambda *_: self._tick())
            signal.siginterrupt(signal.SIGALRM, False)
        self.begin(self._first)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._timed:
            self._tick_every(0.0)
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
        self.clear()

    @staticmethod
    def _tick_every(seconds: float) -> None:
        signal.setitimer(signal.ITIMER_REAL, seconds, seconds)

    def _tick(self) -> None:
        now = time.monotonic()
        if not self._text or now - self._began <= 0.5 * EVERY_S:
            return
        if self._terminal:
            self._say(f"{self._text}: {now - self._began:.0f} s so far{self._left(now)}")
        elif not self._said and self._gets_a_line():
            self._say(f"{self._text}{self._left(now)} ...")

    def _gets_a_line(self) -> bool:
        """In a file or a pipe: the first, the last and every tenth part of many."""
        if self._count is None:
            return True
        number, of = self._count
        return number == 1 or number == of or number % max(of // MOST_LINES, 1) == 0

    def _left(self, now: float) -> str:
        if self._count is None or self._count[0] < 2:
            return ""
        number, of = self._count
        each = (self._began - self._counting_since) / (number - 1)
        left = each * (of - number + 1) - (now - self._began)
        return f", about {max(left, 1.0):.0f} s left" if left > 0 else ""  # a part that lasts longer than all that should be left

    def _say(self, text: str) -> None:
        self._said = True
        if not self._terminal:
            echo(text, err=True)
            return
        self.clear()
        shown = shortened(text, shutil.get_terminal_size().columns - 2)
        echo(shown, err=True, nl=False)
        self._written = len(shown)

    def clear(self) -> None:
        """Take the line away, before something else is printed."""
        if self._written:
            sys.stderr.write("\r" + " " * self._written + "\r")
            sys.stderr.flush()
            self._written = 0
