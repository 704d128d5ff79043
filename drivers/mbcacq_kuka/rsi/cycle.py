"""The RSI cycle, in a process of its own: receive, answer, then record and prepare the next answer; shortly before the next telegram is
due, rehearse. Nothing else may share its interpreter.

Started as ``python -m mbcacq_kuka.rsi.cycle`` with its settings as one JSON line on standard input. It answers 'ready' (or why
not) on standard output. When standard input ends, because the driver closed it or died, it brakes, ends the session and exits.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import sys
import threading
import time
from typing import Any

from mbcacq_kuka.rsi.realtime import become_real_time, end_real_time, open_socket, wait
from mbcacq_kuka.rsi.session import RsiSession
from mbcacq_kuka.rsi.shared import Shared
from mbcacq_kuka.rsi.telegram import MAX_DATAGRAM

_POLL_S = 0.02
_REHEARSED_S = 0.3e-3  # before a telegram is due: longer than a rehearsal and than networks jitter, short enough to be remembered
_LOOK = socket.MSG_PEEK | getattr(socket, "MSG_DONTWAIT", 0)  # Windows has no such flag


def run(sock: socket.socket, session: RsiSession, parent_gone: threading.Event) -> None:
    """Until the session is over."""
    receive, monotonic = sock.recvfrom, time.monotonic
    connected = False
    while not session.over:
        if parent_gone.is_set():
            session.close(monotonic())
        if (due := session.due) is not None:
            _rehearse(sock, session, due - _REHEARSED_S - monotonic())
        try:
            data, source = receive(MAX_DATAGRAM)
        except (TimeoutError, BlockingIOError):
            session.idle(monotonic())
            continue
        except ConnectionError:  # an unreachable controller; its silence says the same
            continue
        now = monotonic()
        if now - session.last_heard > 1.5 * session.cycle_s:
            data, source = _newest(sock, session, data, source, now)
        answer = session.reply(data, source, now)
        if answer is not None:
            try:
                sock.send(answer) if connected else sock.sendto(answer, source)
            except OSError:
                pass  # counts as a late answer, which the controller reports back
        session.digest(now)
        if not connected and session.controller is not None:
            connected = _only_from(sock, session.controller)


def _rehearse(sock: socket.socket, session: RsiSession, wait_s: float) -> None:
    """Go the way of the next answer once before its telegram is due, so that it is in the processor's caches, which other programs have
    filled since the last one. Changes nothing; a telegram that comes earlier than that ends the waiting and is answered at once."""
    if wait_s <= 0.0 or select.select([sock], [], [], wait_s)[0]:
        return
    session.rehearse(time.monotonic())
    if os.name == "posix":  # elsewhere looking would wait
        try:
            sock.recvfrom(MAX_DATAGRAM, _LOOK)
        except OSError:
            pass  # nothing there yet


def _only_from(sock: socket.socket, controller: Any) -> bool:
    """From now on the operating system drops what other senders send, before it wakes us."""
    try:
        sock.connect(controller)
    except OSError:
        return False
    return True


def _newest(sock: socket.socket, session: RsiSession, data: bytes, source: Any, now: float) -> tuple[bytes, Any]:
    """After a stall telegrams queue up. Only the newest can still be answered in time; the others are recorded."""
    sock.setblocking(False)
    try:
        while True:
            newer = sock.recvfrom(MAX_DATAGRAM)
            session.reply(data, source, now, in_time=False)
            session.digest(now)
            data, source = newer
    except OSError:
        return data, source
    finally:
        wait(sock, _POLL_S)


def main() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the driver's process, which ends us in order
    if not (line := sys.stdin.readline()):
        return 0  # the driver was interrupted while it started this
    settings = json.loads(line)
    parent_gone = threading.Event()

    def ended(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_IGN)  # a second one inside of set() would wait for the first for ever
        parent_gone.set()

    signal.signal(signal.SIGTERM, ended)
    shared = Shared.attach(settings["shared"])
    try:
        try:
            sock = open_socket(settings["bind"], settings["port"], _POLL_S)
        except (OSError, OverflowError) as error:
            print(json.dumps({"error": str(error)}), flush=True)
            return 1
        with sock:
            session = RsiSession(shared, settings)
            real_time = become_real_time(settings["cpu"])
            threading.Thread(target=_await_end_of_input, args=(parent_gone,), daemon=True).start()
            print(json.dumps({"ready": sock.getsockname()[1], "real_time": real_time}), flush=True)
            run(sock, session, parent_gone)
        return 0
    finally:
        end_real_time()
        shared.close()


def _await_end_of_input(gone: threading.Event) -> None:
    sys.stdin.read()
    gone.set()


if __name__ == "__main__":
    sys.exit(main())
