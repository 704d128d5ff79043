"""What a diagnosis is computed by: processes, the memory that they keep, and the time that they may take.

The pool has workers for calls of the same kind: this process and further ones (loky). They are started anew, not forked, so that threads do
no harm and every system has them. Inside a process that may have no children (a worker of a dask cluster), and with one worker, all calls
are made here, one after the other: the answers are the same.
"""

from __future__ import annotations

import ctypes
import importlib
import multiprocessing
import pickle
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cloudpickle

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.functions import DescribedPart
from mbcacq.errors import CalibrationError
from mbcacq.estimation.solver import one_thread

Refit = Callable[[EffectModel], tuple[EffectModel | None, tuple[str, ...]]]

# Numbers of mallopt of the GNU C library, and their values beforehand (malloc.h).
TRIM_THRESHOLD, MMAP_MAX = -1, -4
USUAL = {TRIM_THRESHOLD: 128 * 1024, MMAP_MAX: 65536}
KEPT = {TRIM_THRESHOLD: 2**31 - 1, MMAP_MAX: 0}


@contextmanager
def freed_memory_kept() -> Iterator[None]:
    """For as long as the context lasts; afterwards the system gets back what is free.

    An array of more than 32 MiB is otherwise asked from the system anew each time and emptied by it page by page. In a diagnosis of 12,000
    poses that was a seventh of the time. Only the GNU C library can be set so; elsewhere nothing happens.
    """
    _set(KEPT)
    try:
        yield
    finally:
        _set(USUAL)
        give_back_freed_memory()


def give_back_freed_memory() -> None:
    """To the system, between the stages of a diagnosis: what lies between arrays that are kept no later array fits into."""
    if (library := _library()) is not None:
        library.malloc_trim(0)


def _set(values: dict[int, int]) -> None:
    if (library := _library()) is not None:
        for number, value in values.items():
            library.mallopt(number, value)


def _library() -> ctypes.CDLL | None:
    """The C library, where it is the GNU one."""
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "gnu_get_libc_version") else None


# loky takes 300 MB more than at first for a leak, and starts another process, which takes a second; a part of a long recording needs more.
ENVIRONMENT = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "LOKY_MAX_MEMORY_LEAK_SIZE": "1e12"}


def cores() -> int:
    """How many processes can run at the same time here."""
    from loky import cpu_count

    return cpu_count()


def _begun() -> None:
    """What another process does first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _set(KEPT)


def _unpacked(call: bytes) -> Any:
    function, arguments = pickle.loads(call)
    return function(*arguments)


class WorkerPool:
    """This process, which takes part, and ``workers`` - 1 others, which start while other work goes on and end with the context.

    The others leave Ctrl-C to this process. The context raises CalibrationError if one was killed.
    """

    @property
    def workers(self) -> int:
        """How many processes there are, this one included."""
        return self._others + 1

    def __init__(self, workers: int = 1):
        self._others = 0 if multiprocessing.current_process().daemon else workers - 1
        if self._others:
            from loky import ProcessPoolExecutor

            self._pool = ProcessPoolExecutor(self._others, initializer=_begun, env=ENVIRONMENT)
            self._calls: list[Future[Any]] = []
            for _ in range(self._others):
                self._pool.submit(importlib.import_module, "mbcacq.diagnosis.validation.folds")  # what they will need

    def map(self, function: Callable[..., Any], *arguments: Iterable[Any], answered: Callable[[int], None] = lambda n: None) -> list[Any]:
        """Answers to all calls, in order. answered: gets about how many there are, after each of this process.

        Which process makes a call depends on its number alone. Raises the error of a call.
        """
        return self.begin(function, *arguments)(answered)

    def begin(self, function: Callable[..., Any], *arguments: Iterable[Any], elsewhere: bool = False) -> Callable[..., list[Any]]:
        """A function that returns what ``map`` does, of ``answered`` if that is wanted. The other processes begin with their calls at once,
        this one with its own when the answers are asked for. elsewhere: the other processes, if any, make all of the calls.
        """
        # Not pool.map: it cancels what is left over when Ctrl-C comes, which loky's own thread then cannot end without a stack trace.
        # All calls of a process go together: what they share, and what is computed from it once, it has once.
        calls, own = list(zip(*arguments, strict=True)), int(not (elsewhere and self._others))
        step = self._others + own
        others = [self.beside(lambda share: [function(*call) for call in share], calls[k::step]) for k in range(own, step)]

        def answers(answered: Callable[[int], None] = lambda count: None) -> list[Any]:
            here = []
            for call in calls[::step] if own else []:
                here.append(function(*call))
                answered(min(len(here) * step, len(calls)))
            each = [*([here] if own else []), *(answer() for answer in others)]
            return [each[k % step][k // step] for k in range(len(calls))]

        return answers

    def beside(self, function: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
        """A function that returns the answer to one call, which another process makes while this one goes on; without another, it is made
        when its answer is asked for.
        """
        if not self._others:
            return partial(function, *arguments)
        # Packed here, not by loky's own thread: this one goes on meanwhile, and computes what the arguments keep for later.
        self._calls.append(self._pool.submit(_unpacked, cloudpickle.dumps((function, arguments))))
        return self._calls[-1].result

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._others:
            from loky.process_executor import BrokenProcessPool

            unfinished = any(not one.done() for one in self._calls)  # nobody asked for the answer
            self._pool.shutdown(wait=True, kill_workers=kind is not None or unfinished)
            if kind and issubclass(kind, BrokenProcessPool):
                raise CalibrationError("a process of the diagnosis was killed (memory?): run it again with --workers 1") from None


SEARCHING = 0.6  # share of the time for the search of the whole recording; what is left is for the parts of its validation


@dataclass(frozen=True)
class TimeBudget:
    """Until when a search may go on.

    Attributes
    ----------
    begun
        Time of ``time.monotonic`` at the start, in s; the processes of one machine share that clock.
    seconds
        How long it may take; infinite by default.
    """

    begun: float = 0.0
    seconds: float = float("inf")

    @classmethod
    def of_minutes(cls, minutes: float | None) -> TimeBudget:
        """From now on; None: without an end."""
        return cls() if minutes is None else cls(time.monotonic(), 60.0 * minutes)

    @property
    def spent(self) -> bool:
        """Whether the time is over."""
        return time.monotonic() > self.begun + self.seconds

    @property
    def for_the_search(self) -> TimeBudget:
        """The part of it in which the whole recording is searched."""
        return replace(self, seconds=SEARCHING * self.seconds)


UNLIMITED = TimeBudget()


@contextmanager
def processes(workers: int) -> Iterator[WorkerPool]:
    """A pool of so many processes, no more than there are parts of a validation, each with one thread."""
    with one_thread(), freed_memory_kept(), WorkerPool(min(workers, OPTIONS.folds)) as pool:
        yield pool


class Refitting:
    """The refit of the effects that are kept, which takes seconds. Validation and conclusion do not depend on it: another process makes it
    meanwhile.
    """

    def __init__(self, refit: Refit | None, pool: WorkerPool):
        self._refit, self._pool = refit, pool
        self._of: list[tuple[str, tuple[DescribedPart, ...]]] = []
        self._answer: Callable[[], tuple[EffectModel | None, tuple[str, ...]]] | None = None

    def begin(self, model: EffectModel) -> None:
        """Begin with a model; with another one than before it is begun anew."""
        of = [(t.key, t.parts) for t in model.terms]
        if self._refit is None or of == self._of:
            return
        self._of = of
        self._answer = self._pool.beside(self._refit, model) if of else None

    @property
    def begun(self) -> bool:
        return self._answer is not None

    def answer(self) -> tuple[EffectModel | None, tuple[str, ...]]:
        """The model as it was fitted, and what is to be noted of it."""
        assert self._answer is not None, "asked of a refit that was begun"
        return self._answer()
