"""Is the recording described as it was made? Signs, units, orders of columns, offsets and frames that fit the data better.

``wrong_descriptions(observations, fit)`` tries simple changes of convention and reports those that remove most of the misfit.
"""

from __future__ import annotations

from mbcacq.description.search import DescriptionFinding, wrong_descriptions
from mbcacq.errors import CalibrationError, ContradictionError
from mbcacq.model.observations import Observations

__all__ = ["DescriptionFinding", "with_likely_cause", "wrong_descriptions"]


def with_likely_cause(error: ContradictionError, observations: Observations) -> CalibrationError:
    """The error with the simple change of the description that removes most of the misfit, where there is one."""
    found = wrong_descriptions(observations)
    return CalibrationError(f"{error}; {'; '.join(map(str, found))}") if found else error
