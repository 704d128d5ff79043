"""A connection that was taken up again: who is there, and does the arm stand where it stood?"""

from __future__ import annotations

import threading
import time

from mbcacq.devices import LinkLost, SafetyStop
from mbcacq_kuka.eki.link import Link
from mbcacq_kuka.eki.telegrams import Hello, State

MOVED_DEG = 0.05  # or mm; more between two connections: somebody moved the arm


def meet(link: Link, deadline: float, ended: threading.Event, poll_s: float) -> tuple[float, Hello, State]:
    """Wait until the controller has said who it is and where the arm is, both of one session of its program. Returns them after the time
    (monotonic, s) at which the last of it came. Raises LinkLost if that is not reported until ``deadline``, or ``ended`` is set."""
    arrival, hello, state = 0.0, None, None
    while hello is None or state is None or hello.session != state.session:
        if ended.is_set() or time.monotonic() > deadline:
            raise LinkLost("it tells neither who nor where it is")
        for heard, new_hello, new_state in link.telegrams(poll_s):
            arrival, hello, state = heard, new_hello or hello, new_state or state
    return arrival, hello, state


def refuse_moved(name: str, before: State, now: State) -> None:
    """Raises SafetyStop if the arm was moved while nobody looked."""
    moved = max(abs(a - b) for a, b in zip(before.axis, now.axis, strict=True))
    if moved > MOVED_DEG:
        raise SafetyStop(f"robot '{name}': the arm was moved by {moved:.2f}° while the connection was lost; start the run again")
