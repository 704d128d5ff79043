"""Exposures of the fake sensor, one after the other in a thread of their own: world to data set to clients."""

from __future__ import annotations

import logging
import queue
import threading
import time
from typing import TYPE_CHECKING

from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.replies import BUSY, CommandRefused
from mbcacq_fakes.protocols.gocator.spoil import spoil

if TYPE_CHECKING:
    from mbcacq_fakes.protocols.gocator.server import FakeGocator

EXPOSURE = "Setup/Devices/Device[@role='0']/Exposure"
TICKS_PER_S = 1.024e6
_BY_TIME = 0
_WAITING = 16
_log = logging.getLogger("mbcacq.fakes.gocator")


class Exposures:
    """``ask`` queues one; ``run`` is the thread, until ``closing``."""

    def __init__(self, sensor: FakeGocator, closing: threading.Event) -> None:
        self._sensor, self._closing = sensor, closing
        self._asked: queue.Queue[int] = queue.Queue(_WAITING)
        self._next_by_time = 0.0
        self.made = 0

    def ask(self) -> None:
        """Raises Refused(BUSY) when too many wait already."""
        try:
            self._asked.put_nowait(self._sensor.ticks())
        except queue.Full:
            raise CommandRefused(BUSY) from None

    def run(self) -> None:
        while not self._closing.is_set():
            try:
                asked = self._asked.get(timeout=0.02)
            except queue.Empty:
                if not self._timer_due():
                    continue
                asked = self._sensor.ticks()
            try:
                self._expose(asked)
            except Exception:
                _log.exception("the exposure failed; no data set is sent")

    def _expose(self, asked: int) -> None:
        sensor = self._sensor
        if sensor.scan_time_s and self._closing.wait(sensor.scan_time_s):
            return
        exposure_us = sensor.files.number(EXPOSURE)
        frame = sensor.source(exposure_us)
        ticks = int(frame.time_s * TICKS_PER_S) if sensor.clock and frame.time_s else sensor.ticks()
        messages = encode.data_set(
            frame,
            exposure_us=exposure_us,
            ticks=0 if sensor.faults.use("old_stamp") else max(ticks, asked),
            index=self.made,
            serial=sensor.serial,
            encoder=sensor.encoder,
            uniform=bool(sensor.files.number("Setup/UniformSpacingEnabled")),
            intensity=bool(sensor.files.number("Setup/IntensityEnabled")),
            generation=sensor.generation,
            volume=sensor.volume,
        )
        self.made += 1
        # A client asks right after connecting; its connection may still wait to be accepted.
        sensor.data.wait_for_client(0.5)
        sensor.data.publish(spoil(messages, sensor.faults))

    def _timer_due(self) -> bool:
        """Whether a job that is triggered by time wants an exposure now; at most 50 a second."""
        files = self._sensor.files
        if not self._sensor.running or int(files.number("Setup/Trigger/Source")) != _BY_TIME or time.monotonic() < self._next_by_time:
            return False
        self._next_by_time = time.monotonic() + 1.0 / max(files.number("Setup/Trigger/FrameRate"), 1e-3)
        return True
