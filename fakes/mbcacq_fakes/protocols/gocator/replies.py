"""Status codes of the control channel as the fake sensor uses them."""

from __future__ import annotations

OK = 1
INVALID_STATE, NOT_FOUND, UNKNOWN_COMMAND, BAD_PARAMETER, NOT_SUPPORTED = -1000, -999, -998, -997, -996
EXISTS, FORMAT, BUSY, NOT_LOGGED_IN = -987, -984, -981, -2001


class CommandRefused(Exception):
    """A command ends with a bad status and no payload."""

    def __init__(self, status: int) -> None:
        super().__init__(status)
        self.status = status
