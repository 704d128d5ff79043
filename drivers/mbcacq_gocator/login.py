"""Logging in, where the sensor's security is switched on."""

from __future__ import annotations

import struct

from mbcacq.devices import ConfigError, ConnectError
from mbcacq_gocator import commands, information
from mbcacq_gocator.control import ControlChannel
from mbcacq_gocator.status import SensorRefused

_ADMINISTRATOR = 1  # 2 is a technician, who may not load jobs
_REQUEST = struct.Struct("<i64s")


def log_in(control: ControlChannel, password: str) -> None:
    """Needed on every new control connection. Does nothing where security is off.

    Raises ConnectError if a password is needed and none is given, ConfigError if it is refused.
    """
    states = information.parse_states(control.request(commands.STATES))
    secured = states.get("security", bool(password))  # firmware 4.x does not say
    if not secured or states.get("login"):
        return
    if not password:
        raise ConnectError("the Gocator demands a log-in; give its administrator's password, or switch its security off in its web page")
    try:
        control.request(commands.LOG_IN, _REQUEST.pack(_ADMINISTRATOR, password.encode()))
    except SensorRefused as error:
        raise ConfigError(f"the Gocator refuses the password of its administrator ({error}); correct it in the plan") from None
