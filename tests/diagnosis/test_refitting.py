"""The refit that begins before the search has ended is that of the effects which are kept in the end."""

from functools import partial
from types import SimpleNamespace

import pytest

from mbcacq.diagnosis.executor import Refitting, WorkerPool


def model(*keys: str) -> SimpleNamespace:
    return SimpleNamespace(terms=tuple(SimpleNamespace(key=key, parts=()) for key in keys))


def fitted(of: SimpleNamespace) -> tuple[list[str], tuple[str, ...]]:
    return [term.key for term in of.terms], ()


@pytest.mark.parametrize("processes", [1, 2])
def test_effects_that_join_after_it_began_are_fitted(processes):
    with WorkerPool(processes) as pool:
        refitting = Refitting(fitted, pool)
        refitting.begin(model("payload"))
        refitting.begin(model("payload", "backlash"))
        assert refitting.answer()[0] == ["payload", "backlash"]


def test_the_same_effects_are_not_fitted_twice():
    begun = []
    refitting = Refitting(fitted, SimpleNamespace(beside=lambda refit, of: begun.append(of) or partial(refit, of)))
    refitting.begin(model("payload"))
    refitting.begin(model("payload"))
    assert refitting.answer()[0] == ["payload"]
    assert len(begun) == 1


def test_without_effects_in_the_end_there_is_no_refit():
    refitting = Refitting(fitted, WorkerPool())
    refitting.begin(model("payload"))
    refitting.begin(model())
    assert not refitting.begun
