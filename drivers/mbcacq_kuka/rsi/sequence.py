"""Which telegram is this: the next one, one after a gap, a repeated one, an old one, or one of another session?"""

from __future__ import annotations

from dataclasses import dataclass

NEXT, REPEATED, OLD, STRANGE = range(4)


@dataclass
class Counts:
    """What the network did so far: all numbers only grow."""

    lost: int = 0
    repeated: int = 0
    old: int = 0
    foreign: int = 0


class Sequence:
    """IPOC by IPOC. ``step``: by how much it grows a telegram; ``window``: so many telegrams back or ahead still belong to the session."""

    def __init__(self, ipoc: int, step: int, window: int, counts: Counts) -> None:
        self.ipoc, self.step, self._window, self._counts = ipoc, step, window, counts

    def take(self, ipoc: int) -> tuple[int, int]:
        """What the telegram is (NEXT ...), and for NEXT how many cycles it is after the last one."""
        steps, rest = divmod(ipoc - self.ipoc, self.step)
        if rest or abs(steps) > self._window:
            return STRANGE, 0
        if steps == 0:
            self._counts.repeated += 1
            return REPEATED, 0
        if steps < 0:
            self._counts.old += 1
            return OLD, 0
        self.ipoc = ipoc
        self._counts.lost += steps - 1
        return NEXT, steps
