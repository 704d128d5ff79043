"""What a status code of a Gocator reply means, and in which words a user should read it. 1 is success, 0 is not."""

from __future__ import annotations

from mbcacq.devices import DeviceFault

OK = 1

STATUS = {
    1: "ok",
    0: "failed",
    -1000: "not possible in the sensor's present state",
    -999: "not found",
    -998: "command not recognised by this firmware",
    -997: "a parameter is out of range",
    -996: "not supported by this model",
    -994: "the sensor is out of memory",
    -993: "timed out inside the sensor",
    -992: "incomplete, or the replay buffer is empty",
    -991: "stream error",
    -990: "closed",
    -989: "file or protocol version not accepted",
    -988: "aborted",
    -987: "already exists",
    -986: "network error",
    -984: "wrong format",
    -981: "busy",
    -980: "conflict",
    -978: "device error",
    -977: "full",
    -2001: "not logged in",
}


class SensorRefused(DeviceFault):
    """The sensor answered a request with a bad status, kept in ``status``."""

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message)
        self.status = status


def meaning(status: int) -> str:
    """The status in words, with its number."""
    return f"{STATUS.get(status, 'unknown status')} ({status})"
