"""A worker pool gives the answers of one process, and what goes wrong in one is reported."""

import os
import signal

import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.validation import cross_validation
from mbcacq.diagnosis.validation.workers import WorkerPool
from mbcacq.errors import CalibrationError

pytestmark = pytest.mark.filterwarnings("ignore:This process.*fork:DeprecationWarning")  # the runner of these tests has threads


class Job:
    def __init__(self, number):
        self.number, self.asked, self.home = number, 0, os.getpid()

    def square(self, offset):
        self.asked += 1
        return self.number**2 + offset, self.asked

    def where(self):
        return self.home

    def fail(self):
        raise CalibrationError("the recording does not determine the cell") if self.number == 3 else ValueError(self.number)

    def die(self):
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture
def alone(monkeypatch):
    """As in the command, which has one thread; the runner of these tests has several."""
    monkeypatch.setattr("threading.active_count", lambda: 1)


def test_answers_come_in_order_and_jobs_keep_their_state(alone):
    with WorkerPool(Job, 5, workers=2) as pool:
        assert pool.ask("square", 100) == [(100 + k * k, 1) for k in range(5)]
        assert pool.ask("square", 0) == [(k * k, 2) for k in range(5)]
        homes = pool.ask("where")
    assert len(set(homes)) == 2
    assert os.getpid() not in homes


def test_nothing_is_forked_while_other_threads_run(monkeypatch):
    monkeypatch.setattr("threading.active_count", lambda: 2)
    with WorkerPool(Job, 3, workers=2) as pool:
        assert set(pool.ask("where")) == {os.getpid()}


def test_an_error_in_a_worker_is_raised_in_the_caller(alone):
    with WorkerPool(lambda k: Job(k + 3), 1, workers=2) as pool, pytest.raises(CalibrationError, match="does not determine"):
        pool.ask("fail")
    with WorkerPool(lambda k: Job(k + 3), 2, workers=2) as pool, pytest.raises(CalibrationError, match="does not determine"):
        pool.ask("fail")


def test_a_killed_worker_is_reported_and_none_stays_behind(alone):
    with WorkerPool(Job, 2, workers=2) as pool, pytest.raises(CalibrationError, match="--workers 1"):
        pool.ask("die")
    assert not any(process.is_alive() for process in pool.processes)


def test_two_workers_give_the_same_cross_validation_as_one(plan, alone):
    setup = model_fit.prepare(simulated.observe(plan, 160, [("joint_compliance", ("A2",), [2.5e-6], None)]))
    full = model_fit.fit_model(setup)

    one, two = cross_validation.cross_validate(setup, full, 4), cross_validation.cross_validate(setup, full, 4, workers=2)

    assert one.after.chi2_dof < 0.7 * one.before.chi2_dof
    assert two == one
