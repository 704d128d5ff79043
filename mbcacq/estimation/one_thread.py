"""One thread of linear algebra: the matrices are small, and two threads take longer for them than one, and three times the work."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _libraries() -> ThreadpoolController:
    """The libraries of linear algebra that are loaded; looking for them takes a millisecond, which a calibration has once."""
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """A context in which numpy and SciPy have one thread."""
    return _libraries().limit(limits=1)
