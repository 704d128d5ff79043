"""Steps that must end: run in a thread, given up after a while, with the place where they hang."""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

from mbcacq.devices import MbcacqError


class Hang(AssertionError):
    """A step did not end in time."""


def bounded(what: str, step: Callable[[], Any], limit_s: float) -> Any:
    """The step's result; what it raises is raised here. Raises Hang after ``limit_s``."""
    result: list[Any] = []
    error: list[BaseException] = []

    def run() -> None:
        try:
            result.append(step())
        except BaseException as caught:
            error.append(caught)

    thread = threading.Thread(target=run, name=f"step-{what}", daemon=True)
    thread.start()
    thread.join(limit_s)
    if thread.is_alive():
        frame = sys._current_frames().get(thread.ident or 0)
        place = "".join(traceback.format_stack(frame)[-3:]) if frame else ""
        raise Hang(f"{what} did not end within {limit_s:g} s; it hangs at\n{place}")
    if error:
        raise error[0]
    return result[0]


def outcome(what: str, step: Callable[[], Any], limit_s: float) -> MbcacqError | None:
    """None if the step went well, the named error if it raised one. Raises AssertionError for any other exception, Hang."""
    try:
        bounded(what, step, limit_s)
    except MbcacqError as error:
        sentence(error)
        return error
    except AssertionError:
        raise
    except Exception as error:
        raise AssertionError(f"{what} raised {type(error).__name__} ({error}), which is none of mbcacq's errors") from error
    return None


def demand(condition: object, otherwise: str) -> None:
    """As an assertion, but also under ``python -O``."""
    if not condition:
        raise AssertionError(otherwise)


def sentence(error: MbcacqError) -> None:
    """Raises AssertionError unless the message can be shown to a user."""
    text = str(error)
    if len(text) < 15 or "\n" in text or "Traceback" in text:
        raise AssertionError(f"{type(error).__name__} says {text!r}: a message is one sentence with what, where and what to do")


def eventually(condition: Callable[[], bool], limit_s: float, what: str) -> None:
    """Raises AssertionError if the condition does not come true in time."""
    deadline = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what}, not within {limit_s:g} s")
        time.sleep(0.005)
