"""A GoPxL sensor as it was found, and putting it back so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mbcacq.devices import MbcacqError
from mbcacq_gocator.gopxl import tree
from mbcacq_gocator.gopxl.control import JOB_S, NOT_FOUND, STATE_S, GoPxLControl
from mbcacq_gocator.status import SensorRefused


@dataclass
class Found:
    """The sensor as it was found, to be put back. scanner, sensor: the parameters that are changed; added: outputs that are ours;
    protocol: whether the protocol Gocator was on; paths: of the sensor, None while nothing of it was changed."""

    running: bool = False
    job: str = ""
    scanner: dict[str, Any] = field(default_factory=dict)
    sensor: dict[str, Any] = field(default_factory=dict)
    added: list[int] = field(default_factory=list)
    protocol: bool | None = None
    paths: tree.ScannerPaths | None = None


def put_back(control: GoPxLControl, found: Found, job: str) -> None:
    """Every step that can be made; the sensor must be reachable. job: that of the run, '' for the loaded one.

    Raises the first error, after the other steps.
    """
    first: MbcacqError | None = None
    for step in _steps(control, found, job):
        try:
            step()
        except MbcacqError as error:
            first = first or error
        if not control.is_open:
            break
    if first is not None:
        raise first


def _steps(control: GoPxLControl, found: Found, job: str) -> list[Callable[[], object]]:
    paths = found.paths
    steps: list[Callable[[], object]] = [lambda: control.call(tree.STOP, limit_s=STATE_S)]
    steps += [lambda number=number: _remove(control, number) for number in reversed(found.added)]
    if job and found.job and found.job != job:
        steps.append(lambda: control.call(tree.LOAD_JOB, {"name": found.job}, JOB_S))
    elif paths is not None:
        kept = [(paths.group, found.scanner), (paths.sensor, found.sensor)]
        steps += [lambda path=path, values=values: control.update(path, {"parameters": values}) for path, values in kept if values]
    if found.protocol is False:
        steps.append(lambda: control.update(tree.GDP, {"enabled": False}))
    if found.running:
        steps.append(lambda: control.call(tree.START, limit_s=STATE_S))
    return steps


def _remove(control: GoPxLControl, number: int) -> None:
    try:
        control.call(f"{tree.GDP_OUTPUTS}/commands/remove", {"outputId": number})
    except SensorRefused as error:
        if error.status != NOT_FOUND:  # it went with another job, or in an attempt before this one
            raise
