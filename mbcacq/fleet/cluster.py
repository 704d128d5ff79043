"""Tasks on a cluster of dask: one of this computer, or one whose scheduler is given."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any

from mbcacq.errors import ConfigError, ConnectError
from mbcacq.fleet.evaluation import FAILED, FORMAT, FleetTask, evaluate_recording
from mbcacq.fleet.recordings import FleetRecording
from mbcacq.fleet.store import StoredResult, stored_result

LOOPBACK = "127.0.0.1"
CONNECT_S = 10.0
QUIET = logging.CRITICAL
SETTINGS = {
    "distributed.scheduler.allowed-failures": 1,  # a recording at which two workers end is given up
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.comm.timeouts.connect": "600s",  # on a busy computer processes start slowly
    "distributed.comm.timeouts.tcp": "600s",
    "distributed.scheduler.worker-ttl": None,  # a long computation is no lost worker
}


def evaluated(
    recordings: Sequence[FleetRecording], stamps: Sequence[str], task: FleetTask, workers: int, scheduler: str | None
) -> Iterator[tuple[FleetRecording, StoredResult]]:
    """Each recording with what came of it, in the order in which they are done. stamps: of the recordings before they are read.

    workers: processes of a cluster of this computer, which is closed in the end, whatever happens. scheduler: address of a running
    cluster instead; its workers must see the recordings under the same paths. Raises ConnectError where it does not answer.
    """
    try:
        from dask import config
        from dask.distributed import Client, LocalCluster, as_completed
    except ImportError as error:
        raise ConfigError("a fleet needs dask: pip install 'mbcacq[fleet]'") from error
    logging.getLogger("distributed").setLevel(QUIET)  # what goes wrong with a recording stands in its row
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
                client = closing.enter_context(Client(closing.enter_context(cluster)))
            else:
                client = closing.enter_context(Client(scheduler, timeout=CONNECT_S))
        except (OSError, ValueError) as error:
            where = "of this computer" if scheduler is None else f"at {scheduler}"
            raise ConnectError(
                f"the cluster {where} does not answer ({error or type(error).__name__}); try again, or look whether its scheduler runs"
            ) from error
        futures = client.map(evaluated_and_written, recordings, stamps, task=task, pure=False)
        by_key = {future.key: one for future, one in zip(futures, recordings, strict=True)}
        # Results are fetched while others are stored.
        waiting = as_completed(futures, with_results=True, raise_errors=False)
        del futures
        for future, result in waiting:
            recording = by_key[future.key]
            yield recording, result if isinstance(result, StoredResult) else _failed(recording, result)
            future.release()


def evaluated_and_written(recording: FleetRecording, stamp: str, task: FleetTask) -> StoredResult:
    """What a worker does: also the writing of the text, so that the one process that collects all results only stores it."""
    return stored_result(evaluate_recording(recording, task), stamp)


def _failed(recording: FleetRecording, result: Any) -> StoredResult:
    """A failed row, of a task that ended with an error; result: the error, or its type, itself and where it was raised."""
    error = result[1] if isinstance(result, tuple) else result
    row = {"recording": recording.path, "arm": recording.arm, "time": recording.time or None, "status": FAILED}
    ended = type(error).__name__ == "KilledWorker"
    reason = "the process that worked on it was ended (memory?), twice" if ended else f"unexpected {type(error).__name__}: {error}"
    return stored_result({"format": FORMAT, "row": row | {"reason": reason}}, "")
