"""A closed terminal and ``kill`` end a command as Ctrl-C does: in order, with nothing left behind."""

from __future__ import annotations

import signal

from mbcacq.errors import Aborted


def end_in_order_on_signals(what: str = "the run") -> None:
    """Raise Aborted in the main thread at SIGTERM and SIGHUP. what: subject of the sentence."""

    def end(number: int, frame: object) -> None:
        for each in numbers:
            signal.signal(each, signal.SIG_IGN)  # once is enough; a second one must not disturb the closing
        raise Aborted(f"{what} was ended by {signal.Signals(number).name}")

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    for number in numbers:
        if signal.getsignal(number) == signal.SIG_DFL:  # nohup stays nohup
            signal.signal(number, end)
