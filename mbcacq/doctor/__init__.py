"""Is everything there that a run needs? One line a thing, and a cure with each line that is not well. Nothing is moved."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from mbcacq.doctor.line import CheckupLine, from_error

if TYPE_CHECKING:
    from mbcacq.plan import LoadedPlan

__all__ = ["CheckupLine", "checkup", "from_error"]


def checkup(loaded: LoadedPlan | None, arm: bool = False) -> Iterator[CheckupLine]:
    """This computer; with a plan also its ports and its devices. arm: connect a robot too that is not on this computer's loopback, which
    can switch its drives on."""
    from mbcacq.doctor import computer, installed, network

    yield from computer.lines()
    yield from installed.lines(loaded)
    if loaded is not None:
        from mbcacq.doctor import devices

        yield from network.lines(loaded)
        yield from devices.lines(loaded, arm)
