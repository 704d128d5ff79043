"""A snapshot sensor that runs GoPxL as an mbcacq scanner, by software trigger."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from mbcacq.devices import (
    Aborted,
    ConnectError,
    ContextDevice,
    Description,
    DeviceTimeout,
    Field,
    IdentityError,
    MbcacqError,
    ProtocolError,
    Scan,
)
from mbcacq_gocator.generation import classic_answers
from mbcacq_gocator.gopxl import tree
from mbcacq_gocator.gopxl.control import GoPxLControl
from mbcacq_gocator.gopxl.discovery import located
from mbcacq_gocator.gopxl.options import GoPxLOptions
from mbcacq_gocator.gopxl.restore import Found, put_back
from mbcacq_gocator.gopxl.session import GoPxLSession
from mbcacq_gocator.guard import HealthGuard
from mbcacq_gocator.named_errors import named

_FIELDS = (
    Field("points", "mm", (-1, 3), meaning="valid points in the scanner frame, right-handed, float32"),
    Field("intensity", "1", (-1,), meaning="grey value of each point"),
    Field("pixel", "1", (-1,), meaning="row * columns + column of each point"),
    Field("time_s", "s", meaning="the sensor's system time at the exposure, 0 where it sends no stamp"),
    Field("health", "", rate_hz=1.0, meaning="temperatures and counters by name"),
)
_BACKOFF_S = 0.2
_RESTORE_CONNECT_S, _RESTORE_REPLY_S = 1.0, 5.0  # of a new connection, only to put settings back
_log = logging.getLogger("mbcacq.gopxl")


class GoPxL(ContextDevice):
    """Driver ``gopxl``. ``model`` is what the sensor must call itself ('3504'; '' for any).

    Once stopped it stays stopped: ``capture`` raises Aborted until the next ``connect``.
    """

    options_model = GoPxLOptions

    first_contact = (
        "The sensor's laser warnings are in place; `mbcacq doctor {plan}` finds it, and names serial number and GoPxL version.",
        "GoPxL's own page shows a surface of the artefact, whole, in the middle of the field of view, before mbcacq connects.",
        "At the first scan of the first run: points and balls lie where GoPxL shows them; z points to the sensor.",
        "Afterwards the sensor has its own settings again, as GoPxL's page shows them.",
    )

    def __init__(self, name: str, model: str = "", options: Mapping[str, Any] | None = None) -> None:
        self.name, self.model = name, model
        self.options = GoPxLOptions.read(name, options or {})
        self._cancel = threading.Event()
        self._one_capture = threading.Lock()
        self._session: GoPxLSession | None = None
        self._found: Found | None = None
        self._wanted = False
        self._place = self.options
        self._guard = HealthGuard(self.options.temperature_warning_C, self.options.temperature_stop_C)
        self._exposure_us = self.options.exposure_us
        self._description = Description("scanner", model or "LMI GoPxL sensor", _FIELDS)

    def connect(self) -> None:
        """Raises ConnectError, IdentityError, ConfigError (job, output, alignment), DeviceFault, DeviceTimeout, ProtocolError."""
        self._cancel.clear()
        self._wanted = True
        try:
            self._connect()
        except BaseException:
            self._restore()  # a set-up that ended half way
            raise

    def describe(self) -> Description:
        return self._description

    def capture(self, exposure_us: float | None = None) -> Scan:
        """Expose once. Connects anew after a dropped connection, a few times.

        Raises DeviceTimeout, ProtocolError, DeviceFault, ConnectError (the sensor stays away), Aborted (``stop`` was called).
        """
        if not self._wanted:
            raise ConnectError(f"scanner '{self.name}' is not connected; call connect first")
        with self._one_capture:
            if exposure_us is not None:
                self._exposure_us = exposure_us
            for attempt in range(self.options.retries + 1):
                if self._cancel.is_set():
                    raise Aborted(f"scanner '{self.name}' was stopped; connect it again before the next scan")
                try:
                    return self._expose()
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
                    self._drop()  # what is still under way must not be taken for the next scan
                    raise
        raise AssertionError("unreachable")

    def stop(self) -> None:
        """No scan goes on; the sensor itself is brought to rest by ``close``, or by the next ``connect``."""
        self._cancel.set()

    def close(self) -> None:
        """Stop, put settings, outputs and the protocol back as they were found, release everything."""
        self.stop()
        self._wanted = False
        with self._one_capture:
            try:
                self._restore()
            finally:
                self._drop()

    def _expose(self) -> Scan:
        session = self._connect()
        with named(self.name):
            scan = session.expose(self._exposure_us)
            return replace(scan, warnings=self._guard.look(scan.health))

    def _connect(self) -> GoPxLSession:
        if self._session is not None and self._session.has_ended:
            self._drop()  # nothing is under way
        if self._session is not None:
            return self._session
        with named(self.name):
            place = self._place = located(self.options)
            session = GoPxLSession(place, self.model, self._cancel.is_set, self._found)
            self._found = session.found
            try:
                session.open()
            except IdentityError:
                raise
            except ConnectError as error:
                if "GoPxL control" in str(error) and classic_answers(place.address):
                    raise ConnectError(f"the sensor at {place.address} runs classic Gocator firmware; use driver: gocator") from None
                raise
        self._session = session
        info = session.info or tree.SensorInfo(0, "", "")
        firmware = f"GoPxL {info.build}".strip() + f", API {info.api}"
        self._description = Description("scanner", info.model, _FIELDS, str(info.serial), firmware)
        return session

    def _restore(self) -> None:
        """Over the connection that stands, or a new one where it was cut. What cannot be put back is said, not raised."""
        (found, self._found), session = (self._found, None), self._session
        if found is None or found.paths is None:
            return
        wanted = found if self.options.restore else Found(paths=found.paths)  # only to rest
        job = self.options.job if self.options.restore else ""
        self._cancel.clear()
        try:
            if session is not None and session.control.is_open:
                with suppress(ConnectError, DeviceTimeout, ProtocolError):
                    return put_back(session.control, wanted, job)
            place = self._place
            limit_s = min(place.reply_limit_s or _RESTORE_REPLY_S, _RESTORE_REPLY_S)
            spare = GoPxLControl(place.address, place.control_port, _RESTORE_CONNECT_S, limit_s)
            try:
                spare.open()
                put_back(spare, wanted, job)
            finally:
                spare.close()
        except MbcacqError as error:
            _log.warning("scanner '%s': its settings could not be put back as they were: %s", self.name, error)
        finally:
            self._cancel.set()

    def _drop(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.close()
