"""Several pieces of work of the same kind, side by side in processes where that is possible and asked for.

Each piece is made once and asked questions afterwards. Processes are forked, so what a piece is made of need not be sent; answers must be
picklable. With one worker, or where forking is not safe, the pieces are made here, one after the other: the answers are the same.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Callable
from typing import Any

from mbcacq.errors import CalibrationError

MOST_WORKERS = 8


def cores() -> int:
    """How many processes can run side by side here."""
    free = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(free, MOST_WORKERS)


class WorkerPool:
    """make(k): piece k of ``count``, with methods to be asked. Use as a context."""

    def __init__(self, make: Callable[[int], Any], count: int, workers: int = 1):
        self.pieces, self.lines, self.processes = [], [], []
        if min(workers, count) > 1 and sys.platform == "linux" and threading.active_count() == 1:
            self._fork(make, count, min(workers, count))
        else:
            self.pieces = [make(k) for k in range(count)]

    def _fork(self, make, count, workers) -> None:
        context = multiprocessing.get_context("fork")
        for first in range(workers):
            here, there = context.Pipe()
            process = context.Process(target=_work, args=(there, make, range(first, count, workers)), daemon=True)
            process.start()
            there.close()
            self.lines.append(here)
            self.processes.append(process)

    def ask(self, method: str, *args: Any) -> list[Any]:
        """Answers of all pieces, in order. An error of one is raised here."""
        if not self.lines:
            return [getattr(piece, method)(*args) for piece in self.pieces]
        answers: dict[int, Any] = {}
        try:
            for line in self.lines:
                line.send((method, args))
            given = [line.recv() for line in self.lines]
        except (EOFError, OSError):
            raise CalibrationError("a process of the diagnosis was killed (memory?): run it again with --workers 1") from None
        for answer in given:
            if isinstance(answer, Exception):
                raise answer
            answers |= answer
        return [answers[k] for k in sorted(answers)]

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        for line, process in zip(self.lines, self.processes, strict=True):
            line.close()
            process.terminate()
            process.join()


def _work(line, make: Callable[[int], Any], numbers: range) -> None:
    """A process: makes its pieces when first asked, answers until the line is closed."""
    pieces: dict[int, Any] = {}
    while True:
        try:
            method, args = line.recv()
        except (EOFError, KeyboardInterrupt):
            return
        try:
            pieces = pieces or {k: make(k) for k in numbers}
            line.send({k: getattr(piece, method)(*args) for k, piece in pieces.items()})
        except KeyboardInterrupt:
            return
        except Exception as error:  # noqa: BLE001 - whatever it is, it is raised where the question was asked
            line.send(error)
