"""A sensor that runs GoPxL as an mbcacq scanner: surfaces by software trigger, or a stream of profiles."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mbcacq.devices import ConnectError, Description, Fact, Field, IdentityError, Scan, parse_options
from mbcacq_gocator.generation import CLASSIC_CONTROL, answers
from mbcacq_gocator.gopxl import tree
from mbcacq_gocator.gopxl.control import GoPxLControl
from mbcacq_gocator.gopxl.discovery import located
from mbcacq_gocator.gopxl.options import GoPxLOptions
from mbcacq_gocator.gopxl.restore import Found, put_back
from mbcacq_gocator.gopxl.session import GoPxLSession
from mbcacq_gocator.snapshot_scanner import SnapshotScanner

_FIELDS = (
    Field("points", "mm", (-1, 3), meaning="valid points in the scanner frame, right-handed, float32"),
    Field("intensity", "1", (-1,), meaning="grey value of each point"),
    Field("pixel", "1", (-1,), meaning="row * columns + column of each point"),
    Field("time_s", "s", meaning="the sensor's system time at the exposure, 0 if it sends no stamp"),
    Field("health", "", rate_hz=1.0, meaning="temperatures and counters by name"),
)
_log = logging.getLogger("mbcacq.gopxl")


class GoPxL(SnapshotScanner[GoPxLSession]):
    """Driver ``gopxl``. ``model`` is what the sensor must call itself ('3504'; '' for any)."""

    options_model = GoPxLOptions

    first_contact = (
        "The sensor's laser warnings are in place; `mbcacq doctor {plan}` finds it, and names serial number and GoPxL version.",
        "GoPxL's own page shows a surface of the artefact, whole, in the middle of the field of view, before mbcacq connects.",
        "At the first scan of the first run: points and balls lie where GoPxL shows them; z points to the sensor.",
        "Afterwards the sensor has its own settings again, as GoPxL's page shows them.",
    )

    def __init__(self, name: str, model: str = "", options: Mapping[str, Any] | None = None) -> None:
        self.options = parse_options(GoPxLOptions, f"scanner '{name}'", options or {})
        about = Description("scanner", model or "LMI GoPxL sensor", _FIELDS)
        super().__init__(name, model, self.options, self.options.mode, about)
        self._found: Found | None = None
        self._place = self.options

    def _read_facts(self, session: GoPxLSession) -> tuple[Fact, ...]:
        return Fact("alignment", session.alignment()), *super()._read_facts(session)

    def _watch(self, session: GoPxLSession) -> None:
        for warning in self._guard.look(session.health()):
            _log.warning("scanner '%s': %s", self.name, warning)

    def _expose(self, session: GoPxLSession) -> Scan:
        scan = self._confirmed(session, lambda: session.expose(self._exposure_us))
        return replace(scan, warnings=(*scan.warnings, *self._guard.look(scan.health)))

    def _opened(self) -> GoPxLSession:
        place = self._place = located(self.options)
        session = GoPxLSession(place, self.model, self._cancel.is_set, self._found)
        self._found = session.found
        try:
            session.open()
        except IdentityError:
            raise
        except ConnectError as error:
            if "GoPxL control" in str(error) and answers(place.address, CLASSIC_CONTROL):
                raise ConnectError(f"the sensor at {place.address} runs classic Gocator firmware; use driver: gocator") from None
            raise
        info = session.info or tree.SensorInfo(0, "", "")
        firmware = f"GoPxL {info.build}".strip() + f", API {info.api}"
        self._description = Description("scanner", info.model, _FIELDS, str(info.serial), firmware)
        return session

    def _restore(self) -> None:
        found, self._found = self._found, None
        if found is None or found.paths is None:
            return
        wanted, job = (found, self.options.job) if self.options.restore else (Found(paths=found.paths), "")  # only to rest
        self._cancel.clear()
        try:
            self._put_back(self._place, GoPxLControl, lambda control: put_back(control, wanted, job))
        finally:
            self._cancel.set()
