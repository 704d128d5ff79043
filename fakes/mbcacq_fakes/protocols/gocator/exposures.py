"""Exposures of the fake sensor, one after the other in a thread of their own: world to data set to clients."""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Callable

from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.data_faults import apply_fault
from mbcacq_fakes.protocols.gocator.files import EXPOSURE, Files
from mbcacq_fakes.protocols.gocator.state import TICKS_PER_S, SensorState
from mbcacq_fakes.world.frame import ScannerFrame

Source = Callable[[float], ScannerFrame]
_BY_TIME = 0
_log = logging.getLogger("mbcacq.fakes.gocator")


def expose_on_request(state: SensorState, source: Source) -> None:
    """Serve ``state.requests``, and jobs that are triggered by time, until the sensor closes."""
    timer = _FrameTimer(state.files)
    while not state.closing.is_set():
        try:
            requested = state.requests.get(timeout=0.02)
        except queue.Empty:
            if not (state.running and timer.due()):
                continue
            requested = state.ticks()
        try:
            _expose(state, source, requested)
        except Exception:
            _log.exception("the exposure failed; no data set is sent")


def _expose(state: SensorState, source: Source, requested: int) -> None:
    """requested: ticks of the request, before which no stamp may lie."""
    options = state.options
    if options.scan_time_s and state.closing.wait(options.scan_time_s):
        return
    exposure_us = state.files.number(EXPOSURE)
    frame = source(exposure_us)
    ticks = int(frame.time_s * TICKS_PER_S) if options.clock and frame.time_s else state.ticks()
    header = encode.DataSetHeader(
        exposure_us=exposure_us,
        ticks=0 if state.faults.use("old_stamp") else max(ticks, requested),
        index=state.exposures,
        serial=state.serial,
        encoder=state.encoder,
        uniform=bool(state.files.number("Setup/UniformSpacingEnabled")),
        intensity=bool(state.files.number("Setup/IntensityEnabled")),
        generation=state.generation,
        volume=options.volume,
    )
    messages = encode.data_set(frame, header)
    state.exposures += 1
    # A client asks right after connecting; its connection may still wait to be accepted.
    state.data.wait_for_client(0.5)
    state.data.publish(apply_fault(messages, state.faults))


class _FrameTimer:
    """Whether a job that is triggered by time wants an exposure now."""

    def __init__(self, files: Files) -> None:
        self._files, self._next_s = files, 0.0

    def due(self) -> bool:
        """At most 50 times a second."""
        if int(self._files.number("Setup/Trigger/Source")) != _BY_TIME or time.monotonic() < self._next_s:
            return False
        self._next_s = time.monotonic() + 1.0 / max(self._files.number("Setup/Trigger/FrameRate"), 1e-3)
        return True
