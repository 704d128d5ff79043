"""A closed terminal, ``kill`` and Ctrl-C end a command in order, with nothing left behind, however often they come."""

from __future__ import annotations

import signal

from mbcacq.errors import Aborted


def interrupt_once(number: int, frame: object) -> None:
    """Handler that raises KeyboardInterrupt at the first Ctrl-C. Later ones are ignored: they would meet the closing, or the interpreter
    while it ends, where nobody can handle them."""
    signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


UNCHANGED = (signal.SIG_DFL, signal.default_int_handler, interrupt_once)


def end_in_order_on_signals(what: str = "the run") -> None:
    """Raise Aborted in the main thread at SIGTERM and SIGHUP, KeyboardInterrupt at SIGINT. what: subject of the sentence.

    The first signal counts. Later ones must not disturb the closing, in which the arm comes to rest and the recording is completed; all of
    it is bounded in time.
    """

    def end(number: int, frame: object) -> None:
        for each in handled:
            signal.signal(each, signal.SIG_IGN)
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        raise Aborted(f"{what} was ended by {signal.Signals(number).name}")

    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    handled = [each for each in numbers if signal.getsignal(each) in UNCHANGED]  # nohup stays nohup
    for number in handled:
        signal.signal(number, end)
