"""Errors of an arm's links as random effects: what the poses hardly determine stays near the nominal arm.

The links of an arm err by much the same amounts, angles of the joints' zeros, other angles and lengths each by their own. Maximum
likelihood gives a badly determined link whatever the noise asks of it, and such errors cancel where poses were measured and nowhere else.
With a common size for each kind of error, estimated by restricted maximum likelihood, the estimate is the best linear unbiased prediction
(Henderson 1975): the same where the poses determine everything, and never worse in expectation where they do not.
"""

from __future__ import annotations

from dataclasses import replace

from mbcacq.estimation.adjustment import Adjustment, made_exact, settle_variances
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.parameters import with_common_sizes
from mbcacq.estimation.solver import with_prior_of


def with_random_links(fitted: Adjustment, options: CalibrationOptions) -> Adjustment:
    """An adjustment with random errors of the links in the place of free ones.

    Parameters
    ----------
    fitted : Adjustment
        With free links; what it holds stays held, and its rejections are where the new ones begin.
    options : CalibrationOptions
        It was made with.

    Returns
    -------
    Adjustment
        The same where the links are to be free, have a prior of their own, or too few of them are free.
    """
    layout = with_common_sizes(fitted.lineariser.layout) if options.random_links else fitted.lineariser.layout
    if layout is fitted.lineariser.layout:
        return fitted
    lineariser = fitted.lineariser.with_layout(layout)
    free = with_prior_of(lineariser, fitted.solution)
    lineariser, solution, noise, weights = settle_variances(lineariser, free, fitted.noise, fitted.weights, options, sizes_first=True)
    solution, noise, weights = made_exact(lineariser, solution, noise, weights, options)
    return replace(fitted, lineariser=lineariser, solution=solution, noise=noise, weights=weights)
