"""What the drivers of both generations of sensors do alike: connect, expose or stream profiles, and put back what was changed."""

from __future__ import annotations

import logging
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np

from mbcacq.devices import (
    Aborted,
    ConfigError,
    ConnectError,
    ContextDevice,
    Description,
    DeviceTimeout,
    Fact,
    IdentityError,
    MbcacqError,
    Profiles,
    ProtocolError,
    Scan,
)
from mbcacq_gocator.guard import HealthGuard
from mbcacq_gocator.named_errors import named
from mbcacq_gocator.request_connection import RequestConnection
from mbcacq_gocator.sensor_session import ProfileStream, SensorSession
from mbcacq_gocator.snapshot_options import SnapshotOptions

FINEST_US = 0.51  # a sensor may keep whole microseconds
_RESTORE_CONNECT_S, _RESTORE_REPLY_S = 1.0, 5.0  # of a new connection, only to put settings back
_EXPOSURES = 3  # of one scan, until two lay their points out alike
_log = logging.getLogger("mbcacq.gocator")


S = TypeVar("S", bound=SensorSession[Any])


def exposure_reported(reported_us: float, wanted_us: float | None) -> str:
    """'as set', or what the sensor says of an exposure (us; 0 for nothing) that somebody else has changed."""
    if wanted_us is None or not reported_us or abs(reported_us - wanted_us) <= FINEST_US:
        return "as set"
    return f"{reported_us:g} us instead of {wanted_us:g} us"


class SnapshotScanner(ContextDevice, ABC, Generic[S]):
    """Implements mbcacq.devices.Scanner and ProfileScanner. mode: of the options, 'profile' for a line scanner. Once stopped it stays
    stopped: ``capture`` raises Aborted until the next ``connect``."""

    def __init__(self, name: str, model: str, options: SnapshotOptions, mode: str, description: Description) -> None:
        self.name, self.model = name, model
        self._exposure_us, self._description = options.exposure_us, description
        self._guard = HealthGuard(options.temperature_warning_C, options.temperature_stop_C)
        self._mode, self._timeout_s = mode, options.timeout_s
        self._stream: ProfileStream | None = None
        self._cancel = threading.Event()
        self._one_capture = threading.Lock()
        self._session: S | None = None
        self._wanted = False
        self._facts: tuple[Fact, ...] = ()
        self._geometry: tuple[object, ...] | None = None

    @abstractmethod
    def _opened(self) -> S:
        """A new session, and what the sensor is in the description."""

    def _watch(self, session: S) -> None:
        """Look at the sensor's health before it measures. Raises DeviceFault where it may not go on."""

    @abstractmethod
    def _expose(self, session: S) -> Scan:
        """One scan, with every warning since the last one."""

    @abstractmethod
    def _restore(self) -> None:
        """Put back what was changed."""

    def _put_back(
        self, place: Any, kind: Callable[..., RequestConnection], put_back: Callable[[Any], None], what: str = "its settings"
    ) -> None:
        """Over the connection that stands, or a new one where it was cut. What cannot be put back is reported, not raised.

        place: options with the address of the sensor. kind: of its control connection.
        """
        control = None if self._session is None else self._session.control
        try:
            if control is not None and control.is_open:
                with suppress(ConnectError, DeviceTimeout, ProtocolError):
                    return put_back(control)
            limit_s = min(place.reply_limit_s or _RESTORE_REPLY_S, _RESTORE_REPLY_S)
            spare = kind(place.address, place.control_port, _RESTORE_CONNECT_S, limit_s)
            try:
                spare.open()
                put_back(spare)
            finally:
                spare.close()
        except MbcacqError as error:
            _log.warning("scanner '%s': %s could not be put back as they were: %s", self.name, what, error)

    def stop(self) -> None:
        self._cancel.set()

    def close(self) -> None:
        """Stop, put job and settings back as they were found, release everything."""
        self.stop()
        self._wanted = False
        with self._one_capture:
            try:
                self._restore()
            finally:
                self._drop()

    def connect(self) -> None:
        """Raises ConnectError, IdentityError, ConfigError (job, exposure, output, alignment), DeviceFault, DeviceTimeout, ProtocolError."""
        self._cancel.clear()
        self._wanted, self._geometry = True, None
        try:
            self._connect()
        except BaseException:
            self._restore()  # a set-up that ended half way
            raise

    def describe(self) -> Description:
        return self._description

    def facts(self) -> tuple[Fact, ...]:
        """Values at the last exposure, or the end of the last stream."""
        return self._facts

    def _read_facts(self, session: S) -> tuple[Fact, ...]:
        about = self._description
        identity = Fact("serial number", about.serial), Fact("firmware", about.firmware, critical=False)
        exposure = session.exposure_set() if self._mode == "profile" else session.exposure
        return Fact("job", session.job()), Fact("exposure", exposure), *identity

    def capture(self, exposure_us: float | None = None) -> Scan:
        """Expose as the options say, over a new connection where the sensor has closed the last one meanwhile.

        Raises ConfigError (it streams profiles), DeviceTimeout, ProtocolError, DeviceFault, ConnectError (the connection broke), Aborted
        (``stop`` was called).
        """
        self._refuse_unconnected()
        if self._mode == "profile":
            raise ConfigError(f"scanner '{self.name}' streams profiles; use a step 'sweep', or another mode in its options")
        with self._one_capture:
            if exposure_us is not None:
                self._exposure_us = exposure_us
            if self._cancel.is_set():
                raise Aborted(f"scanner '{self.name}' was stopped; connect it again before the next scan")
            try:
                session = self._connect()
                with named(self.name):
                    scan = self._expose(session)
                    self._facts = self._read_facts(session)
                    return scan
            except (Aborted, ConnectError, DeviceTimeout, IdentityError, ProtocolError) as error:
                self._drop()  # what is still under way must not be taken for the next scan
                if self._cancel.is_set() and isinstance(error, ConnectError):
                    raise Aborted(f"scanner '{self.name}': the scan was stopped") from error
                raise

    def _confirmed(self, session: S, expose: Callable[[], Scan]) -> Scan:
        """A scan whose geometry is that of the one before, or of a second exposure.

        No checksum guards a message, and one wrong bit of a scale or an offset moves the whole cloud. They are settings of the job. A
        sensor that has others in every scan is believed, with a warning.
        """
        known, scan = [self._geometry], expose()
        while session.geometry not in known and len(known) < _EXPOSURES:
            known.append(session.geometry)
            scan = expose()
        if self._geometry not in (None, session.geometry):
            text = f"scale, offset or size of the scans changed from {self._geometry} to {session.geometry}"
            scan = replace(scan, warnings=(*scan.warnings, text))
        self._geometry = session.geometry
        return scan

    def start_profiles(self) -> None:
        if self._mode != "profile":
            raise ConfigError(f"scanner '{self.name}' takes {self._mode} scans; say mode: profile in its options")
        self._refuse_unconnected()
        with self._streaming():
            session = self._connect()
            self._watch(session)
            self._stream = ProfileStream(session, self._timeout_s, -np.inf if self._stream is None else self._stream.latest_s)

    def _refuse_unconnected(self) -> None:
        if not self._wanted:
            raise ConnectError(f"scanner '{self.name}' is not connected; call connect first")

    def profiles(self) -> Profiles:
        if self._stream is None:
            raise ConfigError(f"scanner '{self.name}' takes no profiles; call start_profiles first")
        with self._streaming():
            return self._stream.taken()

    def end_profiles(self) -> None:
        if self._stream is not None:
            with self._streaming():
                self._stream.end()
                if self._session is not None:
                    self._facts = self._read_facts(self._session)

    @contextmanager
    def _streaming(self) -> Iterator[None]:
        """After an error the next stream has a new connection: nobody knows what is still under way on this one."""
        try:
            with named(self.name):
                yield
        except MbcacqError:
            self._drop()
            raise

    def _connect(self) -> S:
        if self._session is not None and self._session.has_ended:
            self._drop()  # nothing is under way
        if self._session is None:
            with named(self.name):
                self._session = self._opened()
                self._facts = self._read_facts(self._session)
        return self._session

    def _drop(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.close()
