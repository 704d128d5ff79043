"""Where the sensor of a plan is: at the plan's address, or wherever the one with the plan's serial number answers."""

from __future__ import annotations

from mbcacq.devices import ConnectError, is_loopback
from mbcacq_gocator.discovery import FoundSensor, find_sensors
from mbcacq_gocator.options import GocatorOptions

_LOOK_S, _TRIES, _HINT_S = 0.5, 3, 0.5


def located(options: GocatorOptions) -> GocatorOptions:
    """The options with an address. Raises ConnectError if no sensor with that serial number answers."""
    if options.address.strip():
        return options
    assert options.serial is not None
    for _ in range(_TRIES):
        found = find_sensors(_LOOK_S, options.broadcast, options.discovery_port, options.serial)
        mine = [sensor for sensor in found if sensor.serial == options.serial]
        if mine:
            found_at = ("address", "control_port", "health_port", "data_port")
            return options.model_copy(update={key: getattr(mine[0], key) for key in found_at})
    others = find_sensors(_LOOK_S, options.broadcast, options.discovery_port)
    raise ConnectError(
        f"no Gocator with serial {options.serial} answers a broadcast ({_listed(others)}); check its power and cable, that "
        "the firewall lets udp from port 3220 in, or give its address"
    )


def elsewhere(error: ConnectError, options: GocatorOptions) -> ConnectError:
    """The error, with what else answers on the networks of this computer: a wrong address is the usual cause."""
    if is_loopback(options.address):
        return error
    try:
        found = find_sensors(_HINT_S, options.broadcast, options.discovery_port)
    except ConnectError:
        return error
    return type(error)(f"{error}; {_listed(found)}") if found else error


def _listed(found: list[FoundSensor]) -> str:
    if not found:
        return "none does"
    return "found: " + ", ".join(f"{s.model or 'a Gocator'} serial {s.serial} at {s.address}" for s in found[:8])
