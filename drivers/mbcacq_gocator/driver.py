"""The LMI Gocator as an mbcacq scanner, by snapshot or by software trigger."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Any, Self

from mbcacq.devices import (
    Aborted,
    ConnectError,
    Description,
    DeviceTimeout,
    Field,
    IdentityError,
    MbcacqError,
    ProtocolError,
    Scan,
)
from mbcacq_gocator import commands
from mbcacq_gocator.dataset import DataSet, read_set
from mbcacq_gocator.layouts import SURFACE_INTENSITY
from mbcacq_gocator.options import Options
from mbcacq_gocator.points import intensity_of, surface_points
from mbcacq_gocator.session import Session

_FIELDS = (
    Field("points", "mm", (-1, 3), meaning="valid points in the scanner frame, float32"),
    Field("intensity", "1", (-1,), meaning="grey value of each point, if the job delivers it"),
    Field("pixel", "1", (-1,), meaning="row * columns + column of each point"),
    Field("time_s", "s", meaning="the sensor's clock at the exposure"),
    Field("health", "", rate_hz=1.0, meaning="temperatures and counters by name"),
)
_BACKOFF_S = 0.2


class Gocator:
    """Driver ``gocator``. ``model`` is what the sensor must call itself ('3210', a part number; '' for any)."""

    def __init__(self, name: str, model: str = "", options: Mapping[str, Any] | None = None) -> None:
        self.name, self.model = name, model
        self.options = Options.read(name, options or {})
        self._cancel = threading.Event()
        self._one_capture = threading.Lock()
        self._session: Session | None = None
        self._running = False
        self._wanted_exposure_us = self.options.exposure_us
        self._description = Description("scanner", model or "LMI Gocator", _FIELDS)

    def connect(self) -> None:
        """Raises ConnectError, IdentityError, ConfigError (job, exposure), DeviceFault, DeviceTimeout, ProtocolError."""
        if self._session is not None:
            return
        with _named(self.name):
            session = Session(self.options, self.model, self._cancel.is_set)
            session.open()
        self._session, self._running = session, False
        assert session.info is not None
        self._description = Description("scanner", session.info.model, _FIELDS, str(session.info.serial), session.info.firmware_text)

    def describe(self) -> Description:
        return self._description

    def capture(self, exposure_us: float | None = None) -> Scan:
        """Expose once. Connects anew after a dropped connection, a few times.

        Raises DeviceTimeout, ProtocolError, DeviceFault, ConnectError (the sensor stays away), Aborted (``stop`` was called).
        """
        with self._one_capture:
            self._cancel.clear()
            if exposure_us is not None:
                self._wanted_exposure_us = exposure_us
            for attempt in range(self.options.retries + 1):
                try:
                    self.connect()
                    with _named(self.name):
                        return self._capture()
                except IdentityError:
                    self._drop()
                    raise
                except ConnectError as error:
                    self._drop()
                    if self._cancel.wait(_BACKOFF_S * 2**attempt if attempt < self.options.retries else 0):
                        raise Aborted(f"scanner '{self.name}': the scan was stopped") from error
                    if attempt == self.options.retries:
                        raise
                except (Aborted, DeviceTimeout, ProtocolError):
                    self._drop()    # what is still under way must not be taken for the next scan
                    raise
        raise AssertionError("unreachable")

    def stop(self) -> None:
        self._cancel.set()
        session, self._running = self._session, False
        if session is not None:
            try:
                session.stop()
            except MbcacqError:
                session.control.close()

    def close(self) -> None:
        self.stop()
        self._drop()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _capture(self) -> Scan:
        session = self._session
        assert session is not None
        assert session.configuration is not None
        wanted = self._wanted_exposure_us
        if wanted is not None and not session.configuration.exposes_for(wanted):
            if self._running:
                self._running = False
                session.stop()
            session.set_exposure(wanted)
        if not session.health.alive:
            with suppress(MbcacqError):
                session.health.open()
        if self.options.mode == "trigger" and not self._running:
            session.start()
            self._running = True
        asked = session.time_stamp()
        session.control.request(commands.TRIGGER if self.options.mode == "trigger" else commands.SNAPSHOT)
        return self._scan(session, self._wait_for_surface(session, asked))

    def _wait_for_surface(self, session: Session, asked: int) -> DataSet:
        """The first data set with a surface that was exposed after ``asked`` (ticks)."""
        assert session.reader is not None
        deadline = time.monotonic() + self.options.timeout_s
        stamp_only, early, other = 0, 0, ""
        while True:
            try:
                data = read_set(session.reader, deadline)
            except DeviceTimeout as error:
                raise self._explained(session, error, stamp_only, early, other) from None
            if data.stamp is not None and data.stamp.timestamp < asked:
                early += 1
            elif data.surface is not None:
                return data
            elif data.contents:
                other = data.contents
            else:
                stamp_only += 1

    def _explained(self, session: Session, error: DeviceTimeout, stamp_only: int, early: int, other: str) -> DeviceTimeout:
        waited = f"no scan within {self.options.timeout_s:g} s"
        if stamp_only and not other:
            return DeviceTimeout(f"{waited}: {stamp_only} data set(s) came with only a stamp; in the job, open Output > Ethernet, choose "
                                 "the protocol Gocator and tick the surface, then save the job")
        if other:
            return DeviceTimeout(f"{waited}: the sensor sent {other} but no surface; set the job's scan mode to Surface and tick the "
                                 "surface under Output > Ethernet")
        if early:
            return DeviceTimeout(f"{waited}: only {early} older data set(s) came; check that nothing else triggers the sensor")
        return DeviceTimeout(f"{waited}: {error}; in the job, tick the surface under Output > Ethernet > Gocator, and check that "
                             f"port {self.options.data_port} is not blocked")

    def _scan(self, session: Session, data: DataSet) -> Scan:
        assert data.surface is not None
        assert session.configuration is not None
        surface = surface_points(data.surface)
        grey = data.arrays.get(SURFACE_INTENSITY)
        return Scan(
            points=surface.points, pixel=surface.pixel, shape=surface.valid.shape,
            intensity=None if grey is None else intensity_of(grey, surface),
            time_s=data.stamp.time_s if data.stamp else 0.0, frame=data.stamp.frame if data.stamp else 0,
            exposure_us=session.configuration.exposure_us or 0.0, measurements=data.measurements, health=session.health.values(),
        )

    def _drop(self) -> None:
        session, self._session, self._running = self._session, None, False
        if session is not None:
            session.close()


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Puts the device's name in front of the messages of errors that pass."""
    prefix = f"scanner '{name}'"
    try:
        yield
    except MbcacqError as error:
        if error.args and not str(error.args[0]).startswith(prefix):
            error.args = (f"{prefix}: {error.args[0]}", *error.args[1:])
        raise
