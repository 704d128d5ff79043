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


_TURN = 1 << 32  # the counter has 32 bits and begins again; some print them signed


def advance(before: int, now: int) -> int:
    """By how much the counter went on from one IPOC to another, negative if it went back: the shorter way round."""
    return (now - before + _TURN // 2) % _TURN - _TURN // 2


class Sequence:
    """IPOC by IPOC. ``step``: by how much it grows a telegram; ``window``: so many telegrams back or ahead still belong to the session.
    ``count`` goes on where IPOC begins again."""

    def __init__(self, ipoc: int, step: int, window: int, counts: Counts) -> None:
        self.ipoc = self.count = ipoc
        self.step, self._window, self._counts = step, window, counts

    @property
    def next(self) -> int:
        """IPOC of the next telegram, but where it begins again."""
        return self.ipoc + self.step

    def take(self, ipoc: int) -> tuple[int, int]:
        """What the telegram is (NEXT ...), and for NEXT how many cycles it is after the last one."""
        steps, rest = divmod(advance(self.ipoc, ipoc), self.step)
        if rest or abs(steps) > self._window:
            return STRANGE, 0
        if steps == 0:
            self._counts.repeated += 1
            return REPEATED, 0
        if steps < 0:
            self._counts.old += 1
            return OLD, 0
        self.ipoc = ipoc
        self.count += steps * self.step
        self._counts.lost += steps - 1
        return NEXT, steps
