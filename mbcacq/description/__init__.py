"""Is the recording described as it was made? Signs, units, orders of columns, offsets and frames that fit the data better.

``wrong_descriptions(observations, fit)`` tries simple changes of convention and reports those that remove most of the misfit.
"""

from mbcacq.description.search import DescriptionFinding, wrong_descriptions

__all__ = ["DescriptionFinding", "wrong_descriptions"]
