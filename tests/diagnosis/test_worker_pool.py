"""A worker pool gives the answers of one process, and what goes wrong in one is reported."""

import multiprocessing
import os
import signal
import threading
from types import SimpleNamespace

import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.validation import cross_validation
from mbcacq.diagnosis.validation.workers import WorkerPool
from mbcacq.errors import CalibrationError


@pytest.fixture(scope="module")
def pool():
    with WorkerPool(2) as pool:
        yield pool


def test_answers_come_in_order_from_other_processes_beside_threads(pool):
    waiting = threading.Event()
    thread = threading.Thread(target=waiting.wait)
    thread.start()
    try:
        assert pool.map(lambda k, offset: k * k + offset, range(5), [100] * 5) == [100 + k * k for k in range(5)]
        homes = set(pool.map(lambda k: os.getpid(), range(8)))
    finally:
        waiting.set()
        thread.join()
    assert os.getpid() not in homes


def test_an_error_in_a_worker_is_raised_in_the_caller(pool):
    with pytest.raises(CalibrationError, match="does not determine"):
        pool.map(refuse, [1])


def test_a_killed_worker_is_reported_and_none_stays_behind():
    with WorkerPool(2) as pool:
        homes = set(pool.map(lambda k: os.getpid(), range(8)))
        with pytest.raises(CalibrationError, match="--workers 1"):
            pool.map(lambda k: os.kill(os.getpid(), signal.SIGKILL), [1])
    for process in homes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_a_process_that_may_have_no_children_does_the_work_itself(monkeypatch):
    monkeypatch.setattr(multiprocessing, "current_process", lambda: SimpleNamespace(daemon=True))
    with WorkerPool(2) as pool:
        assert set(pool.map(lambda k: os.getpid(), range(3))) == {os.getpid()}


def refuse(k):
    raise CalibrationError("the recording does not determine the cell")


def test_two_workers_give_the_same_cross_validation_as_one(plan, pool):
    setup = model_fit.prepare(simulated.observe(plan, 160, [("joint_compliance", ("A2",), [2.5e-6], None)]))
    full = model_fit.fit_model(setup)

    one = cross_validation.cross_validate(setup, full, 4)
    two = cross_validation.cross_validate(setup, full, 4, pool)

    assert one.after.chi2_dof < 0.7 * one.before.chi2_dof
    assert two == one
