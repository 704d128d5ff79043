"""Tasks on a cluster of dask: one of this computer, or one whose scheduler is given."""

from __future__ import annotations

import logging
import signal
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any

from mbcacq.errors import ConfigError, ConnectError, RecordingError
from mbcacq.fleet.evaluation import FleetTask, evaluate_recording
from mbcacq.fleet.recordings import FleetRecording
from mbcacq.fleet.row import FAILED, FleetRow
from mbcacq.fleet.store import FleetStore, StoredResult, stored_result

LOOPBACK = "127.0.0.1"
CONNECT_S = 10.0
QUIET = logging.CRITICAL
BATCH_S = 1.0  # of work in a task of the own cluster: a task costs some ms in the process that collects, which shares the cores
MOST = 100  # recordings that are offered with a task
SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,  # a recording at which two workers end is given up
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.preload": [__name__],  # dask_setup below
    "distributed.worker.profile.enabled": False,  # dask's own profiler looks at every worker 100 times a second
    "distributed.admin.tick.interval": "500ms",  # of its watch on the event loops, 20 ms otherwise
    "distributed.comm.timeouts.connect": "600s",  # on a busy computer processes start slowly
    "distributed.comm.timeouts.tcp": "600s",
    "distributed.scheduler.worker-ttl": None,  # a long computation is no lost worker
}
Stamped = tuple[FleetRecording, str]  # with its stamp before it was read


def evaluated(
    recordings: Sequence[FleetRecording], store: FleetStore, task: FleetTask, workers: int, scheduler: str | None
) -> Iterator[tuple[FleetRecording, FleetRow]]:
    """Each recording with its row, in the order in which they are done; its result is in the store by then.

    workers: processes of a cluster of this computer, which is closed in the end, whatever happens; they store each result when it is
    there. scheduler: address of a running cluster instead; its workers must see the recordings under the same paths, and results are
    sent to this process, which stores them. Raises ConnectError if it does not answer, RecordingError if nothing can be stored.
    """
    try:
        from dask import config
        from dask.distributed import Client, LocalCluster, as_completed
    except ImportError as error:
        raise ConfigError("a fleet needs dask: pip install 'mbcacq[fleet]'") from error
    logging.getLogger("distributed").setLevel(QUIET)  # what goes wrong with a recording stands in its row
    left = deque((one, store.stamp(one)) for one in recordings)
    with ExitStack() as closing:
        closing.enter_context(config.set(SETTINGS))
        try:
            if scheduler is None:
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    host=LOOPBACK,
                    dashboard_address=f"{LOOPBACK}:0",  # its own default is a fixed port
                    scheduler_kwargs={"dashboard": False},
                    silence_logs=QUIET,
                )
                client = closing.enter_context(Client(closing.enter_context(cluster), direct_to_workers=True))
            else:
                client = closing.enter_context(Client(scheduler, timeout=CONNECT_S))
        except (OSError, ValueError) as error:
            where = "of this computer" if scheduler is None else f"at {scheduler}"
            raise ConnectError(
                f"the cluster {where} does not answer ({error or type(error).__name__}); try again, or look whether its scheduler runs"
            ) from error
        # Nobody knows how many workers another cluster has or will get: it gets all at once, a task a recording.
        own, at_once = (store, workers) if scheduler is None else (None, len(left))
        waiting = as_completed(with_results=True, raise_errors=False)
        batches: dict[Any, list[Stamped]] = {}  # of the tasks that are under way, by key

        def hand_out() -> None:
            some = []
            while left and len(batches) + len(some) < at_once:
                some.append(_next(left, at_once))
            for batch, future in zip(some, client.map(evaluated_batch, some, task=task, store=own, pure=False), strict=True):
                batches[future.key] = batch
                waiting.add(future)

        hand_out()
        for future, result in waiting:
            batch = batches.pop(future.key)
            done = result if isinstance(result, list) else _ended(batch, store, result)
            left.extendleft(reversed(batch[len(done) :]))
            hand_out()
            for (recording, _), one in zip(batch, done, strict=False):
                if one.text:
                    store.keep(recording, one)
                yield recording, one.row
            future.release()


def dask_setup(worker: object) -> None:
    """Called by dask in each worker of the own cluster as it starts: Ctrl-C ends it at once, without the stack trace of its event loop."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def evaluated_batch(batch: Sequence[Stamped], task: FleetTask, store: FleetStore | None) -> list[StoredResult]:
    """What a worker does: as many recordings of a batch as BATCH_S allows, at least one, in their order; the others go back.

    store: where each result is kept as soon as it is there, so that none is lost or sent; None: results are sent with their text.
    """
    end = time.monotonic() + BATCH_S
    done: list[StoredResult] = []
    for recording, stamp in batch:
        # It may be there: of a worker that was ended amid this batch.
        row = store.row(recording) if store else None
        result = stored_result(*evaluate_recording(recording, task), stamp) if row is None else StoredResult(row, b"")
        if store and result.text:
            result = StoredResult(store.keep(recording, result), b"")
        done.append(result)
        if time.monotonic() > end:
            break
    return done


def _next(left: deque[Stamped], workers: int) -> list[Stamped]:
    """The recordings of the next task: the fewer, the fewer are left, so that in the end all workers are busy."""
    return [left.popleft() for _ in range(min(MOST, -(-len(left) // (2 * workers))))]


def _ended(batch: Sequence[Stamped], store: FleetStore, result: Any) -> list[StoredResult]:
    """The kept rows of a batch whose task ended with an error, and a failed row for the first recording without one, at which it ended.

    result: the error, or its type, itself and where it was raised. Raises RecordingError, which says that nothing can be stored.
    """
    error = result[1] if isinstance(result, tuple) else result
    if isinstance(error, RecordingError):
        raise error
    done: list[StoredResult] = []
    for recording, _ in batch:
        row = store.row(recording)
        if row is None:
            return [*done, _failed(recording, error)]
        done.append(StoredResult(row, b""))
    return done


def _failed(recording: FleetRecording, error: Any) -> StoredResult:
    """A failed row, of a recording at which a task ended with an error."""
    ended = type(error).__name__ == "KilledWorker"
    reason = "the process that worked on it was ended (memory?), twice" if ended else f"unexpected {type(error).__name__}: {error}"
    row = FleetRow(recording=recording.path, arm=recording.arm, time=recording.time or None, status=FAILED, reason=reason)
    return stored_result(row, {}, "")
