"""The LMI Gocator as an mbcacq scanner, by snapshot or by software trigger."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mbcacq.devices import ConfigError, ConnectError, Description, Field, IdentityError, MbcacqError, Scan, parse_options
from mbcacq_gocator import commands
from mbcacq_gocator.bracket import best, merged
from mbcacq_gocator.control import ControlChannel
from mbcacq_gocator.exposure import expose
from mbcacq_gocator.files import SensorFiles
from mbcacq_gocator.generation import GOPXL_CONTROL, answers
from mbcacq_gocator.jobs import Before
from mbcacq_gocator.locate import elsewhere, located
from mbcacq_gocator.login import log_in
from mbcacq_gocator.options import GocatorOptions
from mbcacq_gocator.session import GocatorSession, check_unchanged
from mbcacq_gocator.snapshot_scanner import SnapshotScanner

_FIELDS = (
    Field("points", "mm", (-1, 3), meaning="valid points in the scanner frame, float32"),
    Field("intensity", "1", (-1,), meaning="grey value of each point, if the job delivers it"),
    Field("pixel", "1", (-1,), meaning="row * columns + column of each point"),
    Field("time_s", "s", meaning="the sensor's clock at the exposure"),
    Field("health", "", rate_hz=1.0, meaning="temperatures and counters by name"),
)


class Gocator(SnapshotScanner[GocatorSession]):
    """Driver ``gocator``. ``model`` is what the sensor must call itself ('3210', a part number; '' for any)."""

    options_model = GocatorOptions

    first_contact = (
        "The sensor's laser warnings are in place; `mbcacq doctor {plan}` finds it, and names serial number and firmware.",
        "The web page of the sensor is closed, and no other client is connected.",
        "The sensor's own page shows the artefact whole, in the middle of the field of view, before mbcacq connects.",
        "At the first scan of the first run: points and balls lie where the sensor's page shows them; z points to the sensor.",
        "Pull the sensor's cable at a pose of it: the run waits for it, says so, and goes on once it is plugged in again.",
    )

    def __init__(self, name: str, model: str = "", options: Mapping[str, Any] | None = None) -> None:
        self.options = parse_options(GocatorOptions, f"scanner '{name}'", options or {})
        about = Description("scanner", model or "LMI Gocator", _FIELDS)
        super().__init__(name, model, self.options, self.options.mode, about)
        self._before: Before | None = None
        self._place = self.options
        self._warnings: list[str] = []  # found since the last scan that was returned

    def capture(self, exposure_us: float | None = None) -> Scan:
        """Expose once, or once for each of the option ``exposures_us``; raises ConfigError for an ``exposure_us`` beside that option."""
        if exposure_us is not None and self.options.exposures_us:
            raise ConfigError(
                f"scanner '{self.name}': the option exposures_us already says how long to expose; take exposure_us out of the plan"
            )
        return super().capture(exposure_us)

    def stop(self) -> None:
        super().stop()
        session = self._session
        if session is not None:
            try:
                session.stop()
            except MbcacqError:
                session.control.close()

    def _opened(self) -> GocatorSession:
        self._place = located(self.options)
        session = GocatorSession(self._place, self.model, self._cancel.is_set, self._before)
        try:
            session.open()
        except IdentityError:
            raise
        except ConnectError as error:
            if not session.control.is_open and answers(self._place.address, GOPXL_CONTROL):
                raise ConnectError(f"the sensor at {self._place.address} runs GoPxL; use driver: gopxl") from None
            raise elsewhere(error, self._place) from None
        finally:
            self._before = session.before
        self._describe(session)
        return session

    def _describe(self, session: GocatorSession) -> None:
        """Raises DeviceFault, and closes the session, where the sensor is not set up as at the first connection."""
        try:
            settings = session.settings()
            if self._description.settings:
                check_unchanged(self._description.settings, settings)
        except MbcacqError:
            session.close()
            raise
        info = session.info
        assert info is not None  # the session is open
        self._description = Description("scanner", info.model, _FIELDS, str(info.serial), info.firmware_text, settings=settings)

    def _expose(self, session: GocatorSession) -> Scan:
        scans = [self._exposed(session, exposure_us) for exposure_us in self.options.exposures_us or (self._exposure_us,)]
        scan = scans[0] if len(scans) == 1 else best(scans) if self.options.bracket == "best" else merged(scans)
        news, self._warnings = (*self._warnings, *(text for one in scans for text in one.warnings)), []
        return replace(scan, warnings=news)

    def _exposed(self, session: GocatorSession, exposure_us: float | None) -> Scan:
        """A sensor above the stop limit is not exposed at all. Warnings found before an exposure that fails come with the next scan."""
        self._watch(session)
        scan = self._confirmed(session, lambda: expose(session, exposure_us))
        self._watch(session)
        return scan

    def _watch(self, session: GocatorSession) -> None:
        if session.health.settled:
            self._warnings += self._guard.look(session.health.values())

    def _restore(self) -> None:
        before, self._before = self._before, None
        if before is None or not before.changed or not self.options.restore:
            return

        def put_back(control: ControlChannel) -> None:
            log_in(control, self._place.password)
            control.request(commands.STOP)
            before.restore(SensorFiles(control))

        self._put_back(self._place, ControlChannel, put_back, f"job '{before.job}' and its exposure")
