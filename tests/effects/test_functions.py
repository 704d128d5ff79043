"""Functions that are written down have the values of their formulas, however many are evaluated one after the other."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.described import Evaluation
from mbcacq.effects.functions import sine


def test_functions_that_are_dropped_leave_no_values_to_later_ones(context: Context):
    """A column that nobody holds any more gives its identity to the next one, which is another function."""
    evaluation, q = Evaluation(context), context.value("q2")
    for order in np.arange(1.0, 200.0):
        np.testing.assert_allclose(evaluation([sine("q2", order)], per_pose=True)[:, 0], np.sin(order * q), atol=1e-12)
