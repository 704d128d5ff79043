"""Errors of an arm's links as random effects: what the poses hardly determine stays near the nominal arm.

The links of an arm err by much the same amounts, angles of the joints' zeros, other angles and lengths each by their own. Maximum
likelihood gives a badly determined link whatever the noise asks of it, and such errors cancel where poses were measured and nowhere else.
With a common size for each kind of error, estimated by restricted maximum likelihood, the estimate is the best linear unbiased prediction
(Henderson 1975): the same where the poses determine everything, and never worse in expectation where they do not.
"""

from __future__ import annotations

from dataclasses import replace

from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.parameters import with_common_sizes
from mbcacq.estimation.solver import made_exact, settle_variances


def with_random_links(fitted: Adjustment) -> Adjustment:
    """An adjustment with random errors of the links in the place of free ones.

    Parameters
    ----------
    fitted : Adjustment
        With free links; what it holds stays held, and its rejections are where the new ones begin.

    Returns
    -------
    Adjustment
        The same where the links are to be free, have a prior of their own, or too few of them are free.
    """
    layout = fitted.lineariser.layout
    if not fitted.lineariser.random_links:
        return fitted
    solution = settle_variances(fitted.solution.with_priors(with_common_sizes(layout)), sizes_first=True)
    solution = made_exact(solution)
    return replace(fitted, solution=solution, noise=solution.noise, weights=solution.weights)
