"""Freed memory stays with the process while a diagnosis lasts."""

import ctypes
import sys

import numpy as np
import pytest

from mbcacq.diagnosis.memory import freed_memory_kept

GNU = sys.platform.startswith("linux") and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")


def page_faults() -> int:
    """Page faults of an array of 80 MB that is written and given back."""
    import resource

    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(10_000_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(not GNU, reason="the C library is not the GNU one")
def test_an_array_gets_the_memory_of_the_one_before():
    page_faults()
    each_time = page_faults()
    with freed_memory_kept():
        page_faults()
        again = page_faults()
    assert again < each_time / 4
    assert page_faults() > each_time / 2  # afterwards as before
