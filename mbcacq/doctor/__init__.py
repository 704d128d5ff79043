"""Is everything there that a run needs? One line a thing, and a cure with each line that is not well. Nothing is moved."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from mbcacq.doctor import computer, devices, installed, network
from mbcacq.doctor.line import CheckupLine
from mbcacq.doctor.line import from_error as from_error
from mbcacq.plan import LoadedPlan


def checkup(loaded: LoadedPlan | None, arm: bool = False, progress: Callable[[str], None] = lambda text: None) -> Iterator[CheckupLine]:
    """This computer; with a plan also its ports and its devices. arm: connect a robot too that is not on this computer's loopback, which
    can switch its drives on. progress: gets a sentence a step."""
    progress("looking at this computer")
    yield from computer.lines()
    progress("looking at libraries and drivers")
    yield from installed.lines(loaded)
    if loaded is not None:
        progress("looking at ports and network")
        yield from network.lines(loaded)
        progress("asking the devices")
        yield from devices.lines(loaded, arm)
