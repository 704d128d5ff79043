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
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.errors import CalibrationError


def cores() -> int:
    """How many processes can run at the same time here."""
    free = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(free, OPTIONS.most_workers)


class WorkerPool:
    """make(k): job k of ``count``, with methods to be asked. Use as a context."""

    def __init__(self, make: Callable[[int], Any], count: int, workers: int = 1):
        self.jobs: list[Any] = []
        self.connections: list[Connection] = []
        self.processes: list[BaseProcess] = []
        if min(workers, count) > 1 and sys.platform == "linux" and threading.active_count() == 1:
            self._fork(make, count, min(workers, count))
        else:
            self.jobs = [make(k) for k in range(count)]

    def _fork(self, make: Callable[[int], Any], count: int, workers: int) -> None:
        context = multiprocessing.get_context("fork")
        for first in range(workers):
            here, there = context.Pipe()
            process = context.Process(target=_work, args=(there, make, range(first, count, workers)), daemon=True)
            process.start()
            there.close()
            self.connections.append(here)
            self.processes.append(process)

    def ask(self, method: str, *args: Any) -> list[Any]:
        """Answers of all jobs, in order. Raises the error of a job, and CalibrationError where a process was killed."""
        if not self.connections:
            return [getattr(job, method)(*args) for job in self.jobs]
        answers: dict[int, Any] = {}
        try:
            for connection in self.connections:
                connection.send((method, args))
            received = [connection.recv() for connection in self.connections]
        except (EOFError, OSError):
            raise CalibrationError("a process of the diagnosis was killed (memory?): run it again with --workers 1") from None
        for answer in received:
            if isinstance(answer, Exception):
                raise answer
            answers |= answer
        return [answers[k] for k in sorted(answers)]

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
        try:
            jobs = jobs or {k: make(k) for k in numbers}
            connection.send({k: getattr(job, method)(*args) for k, job in jobs.items()})
        except KeyboardInterrupt:
            return
        except Exception as error:  # noqa: BLE001 - whatever it is, it is raised where the question was asked
            connection.send(error)
