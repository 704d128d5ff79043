"""A pool of worker processes (loky) for calls of the same kind.

Processes are started anew, not forked, so that threads do no harm and every system has them. Inside a process that may have no children
(a worker of a dask cluster), and with one worker, the calls are made here, one after the other: the answers are the same.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.errors import CalibrationError

if TYPE_CHECKING:
    from loky import ProcessPoolExecutor

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def cores() -> int:
    """How many processes can run at the same time here."""
    free = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(free, OPTIONS.most_workers)


class WorkerPool:
    """Processes that start while other work goes on, and end with the context."""

    def __init__(self, workers: int = 1):
        self._pool: ProcessPoolExecutor | None = None
        if workers > 1 and not multiprocessing.current_process().daemon:
            from loky import ProcessPoolExecutor

            self._pool = ProcessPoolExecutor(workers, initializer=_prepare, env=ONE_THREAD)
            for _ in range(workers):
                self._pool.submit(_prepare)

    def map(
        self, function: Callable[..., Any], *arguments: Iterable[Any], answered: Callable[[int], None] = lambda count: None
    ) -> list[Any]:
        """Answers to all calls, in order. answered: gets the number of answers so far, after each.

        Raises the error of a call, and CalibrationError where a process was killed.
        """
        if self._pool is None:
            return _counted(map(function, *arguments), answered)
        from concurrent.futures.process import BrokenProcessPool

        try:
            # Not pool.map: it cancels what is left over when Ctrl-C comes, which loky's own thread then cannot end without a stack trace.
            calls = [self._pool.submit(function, *given) for given in zip(*arguments, strict=False)]
            return _counted((call.result() for call in calls), answered)
        except BrokenProcessPool:
            raise CalibrationError("a process of the diagnosis was killed (memory?): run it again with --workers 1") from None

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, kill_workers=kind is not None)


def _counted(answers: Iterable[Any], answered: Callable[[int], None]) -> list[Any]:
    out = []
    for answer in answers:
        out.append(answer)
        answered(len(out))
    return out


def _prepare() -> None:
    """A worker leaves Ctrl-C to the process that started it, and imports what it will need."""
    import importlib

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    importlib.import_module("mbcacq.diagnosis.validation.folds")
