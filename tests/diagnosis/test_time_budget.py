"""A diagnosis that is out of time ends with what it has compared, and says so."""

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis import executor
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.executor import TimeBudget
from mbcacq.estimation.forward_model import Displacements


def elastic_joint_three(s):
    joint = np.zeros(s.obs.q.shape)
    joint[:, 2] = 4e-6 * s.gravity_torque[:, 2]
    return Displacements(joint=joint)


class Clock:
    """Stands still until it was read so often, then an hour is over."""

    def __init__(self, reads: float):
        self.left = reads

    def monotonic(self) -> float:
        self.left -= 1
        return 0.0 if self.left >= 0 else 3600.0


def with_clock(monkeypatch, reads, data, minutes=10.0):
    monkeypatch.setattr(executor, "time", Clock(reads))
    return diagnose(data, minutes=minutes, folds=2)


@pytest.fixture(scope="module")
def elastic():
    return simulated.observe(simulated.plan(4, 2, 6), 131, [elastic_joint_three])


def test_a_search_without_time_tells_nothing_and_says_why(monkeypatch, elastic):
    found = with_clock(monkeypatch, 1, elastic)

    assert found.verdict == "cannot_tell"
    assert not found.effects
    assert any("time ran out" in note and "--minutes" in note for note in found.notes)


def test_what_was_found_in_time_is_reported_but_not_as_the_answer(monkeypatch, elastic):
    found = with_clock(monkeypatch, 3, elastic)

    assert found.verdict == "cannot_tell"
    assert [(e.name, e.where) for e in found.effects] == [("joint_compliance", ("A3",))]
    assert any("time ran out" in note for note in found.notes)


def test_time_that_suffices_changes_nothing(monkeypatch, elastic):
    limited, unlimited = with_clock(monkeypatch, np.inf, elastic), with_clock(monkeypatch, 0, elastic, minutes=None)

    assert limited.to_json() == unlimited.to_json()
    assert limited.verdict == "explained"
    assert not any("time ran out" in note for note in limited.notes)


def test_the_search_leaves_time_for_the_validation():
    whole = TimeBudget(0.0, 100.0)

    assert whole.for_the_search.seconds < 0.7 * whole.seconds
    assert TimeBudget.of_minutes(None).for_the_search.spent is False
