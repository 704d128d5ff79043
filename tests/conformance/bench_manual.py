"""The positioner that is a person, at a terminal of its own."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from mbcacq_bus.manual import ManualPositioner

from mbcacq.conformance import Stand

EXCUSED = {"refuses_to_work_unconnected": "a person needs no connection"}


@contextmanager
def manual() -> Iterator[Stand]:
    master, slave = os.openpty()
    before, sys.stdin = sys.stdin, os.fdopen(slave, "r")
    try:

        def use(positioner: ManualPositioner) -> None:
            os.write(master, b"\n")
            positioner.go_to("1", "place the artefact at station 1")

        def begin(positioner: ManualPositioner) -> None:
            positioner.go_to("2", "place the artefact at station 2")

        yield Stand(lambda **more: ManualPositioner("tripod", "", more), use, begin=begin)
    finally:
        sys.stdin.close()
        sys.stdin = before
        os.close(master)
