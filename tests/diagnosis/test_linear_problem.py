"""A linearisation is never changed: restrictions and other residuals are new objects that share what depends on the linearisation alone."""

import dataclasses
import pickle

import numpy as np
import pytest

from mbcacq.diagnosis.problem import prepare


@pytest.fixture(scope="module")
def linear(plan):
    return prepare(plan).linear


def test_a_restriction_leaves_the_linear_problem_as_it_was(linear):
    none = np.zeros(len(linear.keep), bool)

    restricted = linear.restricted(none)

    assert linear.keep.any()
    assert not restricted.keep.any()
    assert restricted.unit("joint", 0, 0) is linear.unit("joint", 0, 0)


def test_a_linear_problem_cannot_be_written_to(linear):
    with pytest.raises(dataclasses.FrozenInstanceError):
        linear.residual = np.zeros(3)


def test_a_pickled_linear_problem_has_the_same_columns(linear):
    linear.computed_once("not to be sent", lambda: lambda: None)

    received = pickle.loads(pickle.dumps(linear))

    np.testing.assert_array_equal(received.residual, linear.residual)
    np.testing.assert_array_equal(received.unit("frame", 2, 4), linear.unit("frame", 2, 4))
