"""Which devices are connected again during a run, and for how long: a scanner that restarts, a sensor whose plug was loose.

The arm stands meanwhile. A motion is never repeated.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from mbcacq.acquisition.monitor import RobotMonitor
from mbcacq.devices import Aborted, ConnectError, DeviceTimeout, IdentityError, MbcacqError, Robot, Scan, Scanner, Sensor

PAUSE_S = 1.0
SILENT_TRIES = 2  # exposures that brought nothing, on a connection that stands


class ReconnectingScanner:
    """Captures, and connects anew for up to ``reconnect_s`` when the scanner is gone. ``say(text)`` gets a sentence on it.

    Another exposure is always safe: the arm stands, and nothing of the lost one is used. What is not retried: a refused exposure, a
    wrong device, a malformed message.
    """

    def __init__(self, scanner: Scanner, robot: Robot, reconnect_s: float, say: Callable[[str], None]) -> None:
        self._scanner, self._robot, self._reconnect_s, self._say = scanner, robot, reconnect_s, say
        self.losses = 0

    def capture(self, exposure_us: float | None) -> Scan:
        """Raises what the scanner raised last when the time is over; what stopped the robot, if it is stopped meanwhile."""
        try:
            return self._scanner.capture(exposure_us)
        except IdentityError:
            raise
        except (ConnectError, DeviceTimeout) as error:
            if self._reconnect_s <= 0:
                raise
            self.losses += 1
            self._say(f"{error}; trying again for up to {self._reconnect_s:g} s")
            return self._again(exposure_us, error)

    def _again(self, exposure_us: float | None, error: MbcacqError) -> Scan:
        """Connect and expose until it succeeds or the time is over."""
        serial = self._scanner.describe().serial
        gone_at, deadline, silent = time.monotonic(), time.monotonic() + self._reconnect_s, 0
        with RobotMonitor(self._robot, self._scanner.stop) as monitor:
            while True:
                try:
                    self._scanner.close()
                    self._scanner.connect()
                    self._check_identity(serial)
                    scan = self._scanner.capture(exposure_us)
                    self._say(f"the scanner is back after {time.monotonic() - gone_at:.0f} s; the exposure was taken again")
                    return scan
                except IdentityError:
                    raise
                except (ConnectError, DeviceTimeout) as again:
                    error = again
                    silent += isinstance(again, DeviceTimeout)
                if monitor.error is not None:
                    raise Aborted("the robot was stopped meanwhile")  # the monitor raises by what
                if silent >= SILENT_TRIES or time.monotonic() + PAUSE_S > deadline:
                    raise error
                time.sleep(PAUSE_S)

    def _check_identity(self, serial: str) -> None:
        now = self._scanner.describe().serial
        if serial and now and now != serial:
            raise IdentityError(f"the scanner came back as serial number {now}, it was {serial}; connect the same one and resume the run")


def read_sensor(sensor: Sensor) -> dict[str, float]:
    """Read, and once more on a new connection where the first did not answer. Raises what the second try raised."""
    try:
        return sensor.read()
    except MbcacqError:
        sensor.close()
        sensor.connect()
        return sensor.read()
