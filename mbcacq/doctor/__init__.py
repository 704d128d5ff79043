"""Is everything there that a run needs? One line a thing, and a cure with each line that is not well. Nothing is moved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from mbcacq.plan import LoadedPlan

Level = Literal["ok", "warning", "error"]


@dataclass(frozen=True)
class Line:
    """level: 'error' keeps a run from succeeding. topic: stable name for programs. cure: what to do, '' where all is well."""

    level: Level
    topic: str
    text: str
    cure: str = ""

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def from_error(topic: str, error: BaseException) -> Line:
    """Our errors end with what to do about them, behind the last semicolon."""
    what, _, cure = str(error).rpartition("; ")
    return Line("error", topic, what or str(error), cure if what else "see docs/reference/errors.md")


def checkup(loaded: LoadedPlan | None, arm: bool = False) -> Iterator[Line]:
    """This computer; with a plan also its ports and its devices. arm: connect a robot too that is not on this computer's loopback, which
    can switch its drives on."""
    from mbcacq.doctor import computer, installed, network

    yield from computer.lines()
    yield from installed.lines(loaded)
    if loaded is not None:
        from mbcacq.doctor import devices

        yield from network.lines(loaded)
        yield from devices.lines(loaded, arm)
