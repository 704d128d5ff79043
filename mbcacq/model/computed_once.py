"""What is computed when it is first asked for, and kept."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Computed = TypeVar("Computed")


class ComputedOnce(dict[Hashable, Any]):
    """Results by key. Called with a key and a function, it returns what the function returned at the first call for this key."""

    def __call__(self, key: Hashable, compute: Callable[[], Computed]) -> Computed:
        if key not in self:
            self[key] = compute()
        return self[key]

    def last(self, of: str, key: Hashable, compute: Callable[[], Computed]) -> Computed:
        """The same, but of everything called ``of`` only the result for the key of the last call is kept."""
        if of not in self or self[of][0] != key:
            self[of] = key, compute()
        return self[of][1]
