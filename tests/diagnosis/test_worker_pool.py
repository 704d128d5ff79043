"""A worker pool gives the answers of one process, and what goes wrong in one is reported."""

import multiprocessing
import os
import signal
import threading
import time
from types import SimpleNamespace
from typing import ClassVar

import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.executor import WorkerPool
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.validation.cross_validation import validated
from mbcacq.diagnosis.validation.folds import repeated
from mbcacq.errors import CalibrationError


@pytest.fixture(scope="module")
def pool():
    with WorkerPool(2) as pool:
        yield pool


def test_answers_come_in_order_from_this_process_and_another_beside_threads(pool):
    waiting = threading.Event()
    thread = threading.Thread(target=waiting.wait)
    thread.start()
    try:
        assert pool.map(lambda k, offset: k * k + offset, range(5), [100] * 5) == [100 + k * k for k in range(5)]
        homes = set(pool.map(lambda k: os.getpid(), range(8)))
    finally:
        waiting.set()
        thread.join()
    assert os.getpid() in homes
    assert len(homes) == 2


def test_a_call_beside_is_made_by_another_process_and_without_one_when_asked_for(pool):
    assert pool.beside(lambda k: (k, os.getpid()), 3)() != (3, os.getpid())
    with pytest.raises(CalibrationError, match="does not determine"):
        pool.beside(refuse, 1)()
    made = []
    answer = WorkerPool(1).beside(made.append, 1)
    assert made == []
    answer()
    assert made == [1]


class Noticing:
    """An argument that knows by which threads it was packed."""

    by: ClassVar[list] = []

    def __reduce__(self):
        self.by.append(threading.current_thread())
        return int, ()


def test_another_process_gets_an_argument_as_it_is_when_it_is_asked(pool):
    assert pool.map(lambda k, one: k if isinstance(one, Noticing) else k + one, range(2), [Noticing()] * 2) == [0, 1]
    assert set(Noticing.by) == {threading.main_thread()}  # another thread would pack what this one is changing already


def test_an_error_in_a_worker_is_raised_in_the_caller(pool):
    home = os.getpid()
    with pytest.raises(CalibrationError, match="does not determine"):
        pool.map(lambda k: refuse(k) if os.getpid() != home else None, range(2))


def test_a_killed_worker_is_reported_and_none_stays_behind():
    home, others = os.getpid(), set()

    def kill_the_other():
        with WorkerPool(2) as pool:
            others.update(set(pool.map(lambda k: os.getpid(), range(8))) - {home})
            pool.beside(lambda: os.kill(os.getpid(), signal.SIGKILL))()

    with pytest.raises(CalibrationError, match="--workers 1"):
        kill_the_other()
    assert others
    for process in others:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_a_process_that_may_have_no_children_does_the_work_itself(monkeypatch):
    monkeypatch.setattr(multiprocessing, "current_process", lambda: SimpleNamespace(daemon=True))
    with WorkerPool(2) as pool:
        assert set(pool.map(lambda k: os.getpid(), range(3))) == {os.getpid()}


def test_how_many_answers_there_are_is_said_after_each_of_this_process(pool):
    counts = []
    pool.map(abs, range(5), answered=counts.append)
    assert counts == [2, 4, 5]  # three calls of this process; the other one is about as far


def test_another_process_begins_before_answers_are_asked_for(pool, tmp_path):
    answers = pool.begin(lambda path: path.touch(), [tmp_path / "own", tmp_path / "other"])
    while not (tmp_path / "other").exists():
        time.sleep(0.01)
    assert not (tmp_path / "own").exists()
    answers()
    assert (tmp_path / "own").exists()


def test_calls_that_are_for_others_are_made_here_only_where_there_are_none(pool):
    home = os.getpid()
    assert home not in pool.begin(lambda k: os.getpid(), range(4), elsewhere=True)()
    assert set(WorkerPool(1).begin(lambda k: os.getpid(), range(4), elsewhere=True)()) == {home}


def test_what_nobody_asks_for_is_not_waited_for(tmp_path):
    with WorkerPool(2) as pool:
        pool.beside(lambda path: path.touch() or threading.Event().wait(), tmp_path / "begun")
        while not (tmp_path / "begun").exists():
            time.sleep(0.01)


def test_what_calls_share_a_worker_has_once(pool):
    home, shared = os.getpid(), []
    counts = pool.map(lambda k, one: None if os.getpid() == home else one.append(k) or len(one), range(6), [shared] * 6)
    assert [count for count in counts if count is not None] == [1, 2, 3]


def refuse(k):
    raise CalibrationError("the recording does not determine the cell")


@pytest.fixture(scope="module")
def fitted(plan):
    """A recording with an elastic joint, and its fit."""
    setup = prepare(simulated.observe(plan, 160, [("joint_compliance", ("A2",), [2.5e-6], None)]))
    return setup, model_fit.fit_model(setup)


def test_two_workers_give_the_same_cross_validation_as_one(fitted, pool):
    setup, full = fitted

    one = validated(full, repeated(setup, full, 2, WorkerPool())[0])
    two = validated(full, repeated(setup, full, 2, pool)[0])

    assert one.after.chi2_dof < 0.7 * one.before.chi2_dof
    assert two == one
