"""A pool of workers, of which this process is one and the others are processes of their own (loky), for calls of the same kind.

Processes are started anew, not forked, so that threads do no harm and every system has them. Inside a process that may have no children
(a worker of a dask cluster), and with one worker, all calls are made here, one after the other: the answers are the same.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.errors import CalibrationError

if TYPE_CHECKING:
    from loky import ProcessPoolExecutor

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# loky takes 300 MB more than at first for a leak, and starts another process, which takes a second; a part of a long recording needs more.
NO_LEAK = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e12"}


def cores() -> int:
    """How many processes can run at the same time here."""
    free = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(free, OPTIONS.most_workers)


class WorkerPool:
    """This process and ``workers`` - 1 others, which start while other work goes on and end with the context.

    This process takes part, for a further one would take a core from the work that goes on while it starts.
    """

    def __init__(self, workers: int = 1):
        self._workers = 1 if multiprocessing.current_process().daemon else workers
        self._pool: ProcessPoolExecutor | None = None
        if self._workers > 1:
            from loky import ProcessPoolExecutor

            self._pool = ProcessPoolExecutor(self._workers - 1, initializer=_prepare, env=ONE_THREAD | NO_LEAK)
            for _ in range(self._workers - 1):
                self._pool.submit(_prepare)

    def map(
        self, function: Callable[..., Any], *arguments: Iterable[Any], answered: Callable[[int], None] = lambda count: None
    ) -> list[Any]:
        """Answers to all calls, in order. answered: gets the number of answers so far, after each of this process and after those of
        each other one.

        Which process makes a call depends on its number alone. Raises the error of a call, and CalibrationError where a process was killed.
        """
        calls = list(zip(*arguments, strict=True))
        if self._pool is None:
            return _counted((function(*call) for call in calls), answered)
        with _killed_process_named():
            # Not pool.map: it cancels what is left over when Ctrl-C comes, which loky's own thread then cannot end without a stack trace.
            # All calls of a process go together: what they share, and what is computed from it once, it has once.
            shares = [calls[k :: self._workers] for k in range(1, self._workers)]
            others = [self._pool.submit(_all, function, share) for share in shares]
            out: list[Any] = [None] * len(calls)
            for count, j in enumerate(range(0, len(calls), self._workers)):
                out[j] = function(*calls[j])
                answered(count + 1 + sum(len(share) for share, one in zip(shares, others, strict=True) if one.done()))
            for k, one in enumerate(others, start=1):
                out[k :: self._workers] = one.result()
                answered(len(calls) - sum(len(share) for share, other in zip(shares, others, strict=True) if not other.done()))
        return out

    def beside(self, function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
        """A function that returns the answer to one call, which another process makes while this one goes on. Where there is no other, the
        call is made when its answer is asked for. Raises as ``map`` does.
        """
        if self._pool is None:
            return partial(function, *arguments)
        with _killed_process_named():
            return partial(_answer, self._pool.submit(function, *arguments))

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, kill_workers=kind is not None)


@contextmanager
def _killed_process_named() -> Iterator[None]:
    """Raises CalibrationError where a process was killed."""
    from concurrent.futures.process import BrokenProcessPool

    try:
        yield
    except BrokenProcessPool:
        raise CalibrationError("a process of the diagnosis was killed (memory?): run it again with --workers 1") from None


def _answer(call: Future) -> Any:
    with _killed_process_named():
        return call.result()


def _counted(answers: Iterable[Any], answered: Callable[[int], None]) -> list[Any]:
    out = []
    for answer in answers:
        out.append(answer)
        answered(len(out))
    return out


def _all(function: Callable[..., Any], calls: list[tuple[Any, ...]]) -> list[Any]:
    return [function(*call) for call in calls]


def _prepare() -> None:
    """A worker leaves Ctrl-C to the process that started it, and imports what it will need."""
    import importlib

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    importlib.import_module("mbcacq.diagnosis.validation.folds")
