"""Functions that are written down have the values of their formulas, however many are evaluated one after the other."""

import numpy as np
import pytest

from mbcacq.effects.context import Context
from mbcacq.effects.described import Evaluation
from mbcacq.effects.functions import sine, turned


def test_functions_that_are_dropped_leave_no_values_to_later_ones(context: Context):
    """A column that nobody holds any more gives its identity to the next one, which is another function."""
    evaluation, q = Evaluation(context), context.value("q2")
    for order in np.arange(1.0, 200.0):
        np.testing.assert_allclose(evaluation([sine("q2", order)], per_pose=True)[:, 0], np.sin(order * q), atol=1e-12)


@pytest.mark.parametrize("step", [0.25, 0.3917, 0.5])
def test_many_orders_at_once_are_as_exact_as_each_by_itself(step: float):
    """Orders in equal steps with preferred ones in between, over two turns: against sine and cosine in extended precision."""
    x = np.random.default_rng(3).uniform(-6.3, 6.3, 300)
    orders = np.unique(np.concatenate([np.arange(1.37, 260.0, step), [1.0, 2.0, 4.0, 100.5, 201.0, 259.9999999]]))[:, None]
    exact = orders.astype(np.longdouble) * x.astype(np.longdouble)
    for found, true in zip(turned(x, orders), (np.sin(exact), np.cos(exact)), strict=True):
        np.testing.assert_allclose(found, true.astype(float), rtol=0, atol=1e-12)
