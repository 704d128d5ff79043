"""Freed memory stays with the process while a diagnosis lasts."""

import ctypes
import subprocess
import sys

import pytest

GNU = sys.platform.startswith("linux") and hasattr(ctypes.CDLL(None), "gnu_get_libc_version")

# Page faults of arrays of 80 MB that are written and given back: as usual, while freed memory is kept, and afterwards. In a process of its
# own, since what tests did before in this one decides how much free memory it has.
IN_ITS_OWN_PROCESS = """
import resource
import numpy as np
from mbcacq.diagnosis.executor import freed_memory_kept

def page_faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(10_000_000)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

page_faults()
usual = page_faults()
with freed_memory_kept():
    page_faults()
    kept = page_faults()
print(usual, kept, page_faults())
"""


@pytest.mark.skipif(not GNU, reason="the C library is not the GNU one")
def test_an_array_gets_the_memory_of_the_one_before():
    said = subprocess.run([sys.executable, "-c", IN_ITS_OWN_PROCESS], capture_output=True, text=True, check=True).stdout
    usual, kept, afterwards = map(int, said.split())
    assert kept < usual / 4
    assert afterwards > usual / 2
