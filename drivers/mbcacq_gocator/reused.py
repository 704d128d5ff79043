"""Memory of large arrays that is used again once nothing refers to them: the system need not hand out, and empty, the same pages anew."""

from __future__ import annotations

import weakref
from collections import deque

import numpy as np

_LARGE = 2**20  # bytes; below, the C library keeps the memory by itself
_KEPT = 6  # blocks: of two scans, each with points, pixels and grey values


class ReusedMemory:
    """Makes arrays; the block of one that has ended, with all views of it, is kept for the next one of the same size.

    Safe to use from several threads: taking from and adding to a deque are single steps.
    """

    def __init__(self) -> None:
        self._free: deque[np.ndarray] = deque(maxlen=_KEPT)

    def empty(self, count: int, dtype: type[np.generic]) -> np.ndarray:
        """(count,) of a type, with any content."""
        size = count * np.dtype(dtype).itemsize
        if size < _LARGE:
            return np.empty(count, dtype)
        block = self._taken(size)
        # Over a memoryview, so that a view of a view refers to this array and not to the block under it: it ends with its last view.
        array: np.ndarray = np.frombuffer(block.data, dtype, count)
        weakref.finalize(array, self._free.append, block).atexit = False
        return array

    def _taken(self, size: int) -> np.ndarray:
        for _ in range(len(self._free)):
            try:
                block = self._free.popleft()
            except IndexError:  # another thread was faster
                break
            if block.size == size:
                return block
            self._free.append(block)
        return np.empty(size, np.uint8)
