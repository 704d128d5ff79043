"""The memory of a scan is used again for a later one, but never while anything of the scan is still in use."""

import gc

import numpy as np
import pytest
from mbcacq_gocator.reused import ReusedMemory

COUNT = 2**20


def where(array):
    return array.__array_interface__["data"][0]


@pytest.mark.parametrize(
    "part",
    [
        lambda a: a[:10],
        lambda a: a.reshape(-1, 2)[5:9, 1],
        lambda a: a.view(np.uint32)[::7][3:],
        lambda a: memoryview(a),
        lambda a: np.asarray(memoryview(a))[2:],
        lambda a: a.T[1:].reshape(-1),
    ],
    ids=["slice", "slice of a shape", "other type", "buffer", "array of a buffer", "view of a view"],
)
def test_memory_is_kept_as_long_as_any_view_of_it(part):
    memory = ReusedMemory()
    array = memory.empty(COUNT, np.float32)
    array[:] = 1.0
    at, kept = where(array), part(array)
    before = bytes(kept)
    del array
    gc.collect()
    others = [memory.empty(COUNT, np.float32) for _ in range(3)]
    for other in others:
        other[:] = 2.0
    assert at not in map(where, others)
    assert bytes(kept) == before
    del kept
    gc.collect()
    assert where(memory.empty(COUNT, np.float32)) == at


def test_a_block_of_another_size_is_not_taken():
    memory = ReusedMemory()
    at = where(memory.empty(COUNT, np.float32))
    gc.collect()
    larger = memory.empty(2 * COUNT, np.float32)
    assert larger.size == 2 * COUNT
    assert where(memory.empty(COUNT, np.float32)) == at
