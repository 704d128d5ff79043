"""Pieces of work side by side: the answers are those of one process, and what goes wrong in one is told."""

import os
import signal

import made
import pytest

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.validation import cross_validation
from mbcacq.diagnosis.validation.workers import WorkerPool
from mbcacq.errors import CalibrationError

pytestmark = pytest.mark.filterwarnings("ignore:This process.*fork:DeprecationWarning")  # the runner of these tests has threads


class Piece:
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


def test_answers_come_in_order_and_the_pieces_remember(alone):
    with WorkerPool(Piece, 5, workers=2) as crew:
        assert crew.ask("square", 100) == [(100 + k * k, 1) for k in range(5)]
        assert crew.ask("square", 0) == [(k * k, 2) for k in range(5)]
        homes = crew.ask("where")
    assert len(set(homes)) == 2
    assert os.getpid() not in homes


def test_beside_other_threads_nothing_is_forked(monkeypatch):
    monkeypatch.setattr("threading.active_count", lambda: 2)
    with WorkerPool(Piece, 3, workers=2) as crew:
        assert set(crew.ask("where")) == {os.getpid()}


def test_what_goes_wrong_in_a_process_is_raised_where_it_was_asked(alone):
    with WorkerPool(lambda k: Piece(k + 3), 1, workers=2) as crew, pytest.raises(CalibrationError, match="does not determine"):
        crew.ask("fail")
    with WorkerPool(lambda k: Piece(k + 3), 2, workers=2) as crew, pytest.raises(CalibrationError, match="does not determine"):
        crew.ask("fail")


def test_a_killed_process_is_told_and_none_stays_behind(alone):
    with WorkerPool(Piece, 2, workers=2) as crew, pytest.raises(CalibrationError, match="--workers 1"):
        crew.ask("die")
    assert not any(process.is_alive() for process in crew.processes)


def test_a_proof_shared_by_two_processes_is_the_same_proof(plan, alone):
    setup = model_fit.prepare(made.observe(plan, 160, [("joint_compliance", ("A2",), [2.5e-6], None)]))
    full = model_fit.fit_model(setup)

    one, two = cross_validation.cross_validate(setup, full, 4), cross_validation.cross_validate(setup, full, 4, workers=2)

    assert one.after.chi2_dof < 0.7 * one.before.chi2_dof
    assert two == one
