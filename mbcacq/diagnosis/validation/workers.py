"""A pool of worker processes for several jobs of the same kind.

Each job is made once and asked questions afterwards. Processes are forked, so what a job is made of need not be sent; answers must be
picklable. With one worker, or where forking is not safe, the jobs are made in this process, one after the other: the answers are the
same. Forking needs Linux.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, cast

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.errors import CalibrationError


def cores() -> int:
    """How many processes can run at the same time here."""
    free = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(free, OPTIONS.most_workers)


class WorkerPool:
    """make(k): job k of ``count``, with methods to be asked. Use as a context."""

    def __init__(self, make: Callable[[int], Any], count: int, workers: int = 1):
        self.count = count
        self.jobs: list[Any] = []
        self.connections: list[Connection] = []
        self.processes: list[BaseProcess] = []
        if min(workers, count) > 1 and sys.platform == "linux" and threading.active_count() == 1:
            self._fork(make, count, min(workers, count))
        else:
            self.make = make

    def _fork(self, make: Callable[[int], Any], count: int, workers: int) -> None:
        context = multiprocessing.get_context("fork")
        for first in range(workers):
            here, there = context.Pipe()
            process = context.Process(target=_work, args=(there, make, range(first, count, workers)), daemon=True)
            process.start()
            there.close()
            self.connections.append(here)
            self.processes.append(process)

    def ask(self, method: str, *args: Any, answered: Callable[[int], None] = lambda count: None) -> list[Any]:
        """Answers of all jobs, in order. answered: gets the number of answers so far, after each. Raises the error of a job, and
        CalibrationError where a process was killed."""
        answers: dict[int, Any] = {}
        for k, answer in self._answers(method, args):
            if isinstance(answer, Exception):
                raise answer
            answers[k] = answer
            answered(len(answers))
        return [answers[k] for k in sorted(answers)]

    def _answers(self, method: str, args: tuple[Any, ...]) -> Iterator[tuple[int, Any]]:
        """Number of the job and its answer, or the error in its place, as they come."""
        if not self.connections:
            for k in range(self.count):
                if k == len(self.jobs):
                    self.jobs.append(self.make(k))
                yield k, getattr(self.jobs[k], method)(*args)
            return
        try:
            for connection in self.connections:
                connection.send((method, args))
            for _ in range(self.count):
                (ready, *_) = wait(self.connections)
                yield cast(Connection, ready).recv()
        except (EOFError, OSError):
            raise CalibrationError("a process of the diagnosis was killed (memory?): run it again with --workers 1") from None

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        for connection, process in zip(self.connections, self.processes, strict=True):
            connection.close()
            process.terminate()
            process.join()


def _work(connection: Connection, make: Callable[[int], Any], numbers: range) -> None:
    """A worker process: makes its jobs when first asked, answers until the connection is closed."""
    jobs: dict[int, Any] = {}
    while True:
        try:
            method, args = connection.recv()
        except (EOFError, KeyboardInterrupt):
            return
        for k in numbers:
            try:
                if k not in jobs:
                    jobs[k] = make(k)
                connection.send((k, getattr(jobs[k], method)(*args)))
            except KeyboardInterrupt:
                return
            except Exception as error:  # noqa: BLE001 - whatever it is, it is raised where the question was asked
                connection.send((k, error))
