"""What a driver's author provides: a device (or its fake) behind proxies, and one ordinary operation with a known result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

from mbcacq import devices
from mbcacq.conformance.proxy import Proxy

PROTOCOLS = {"robot": devices.Robot, "scanner": devices.Scanner, "positioner": devices.Positioner, "sensor": devices.Sensor}


@dataclass
class Stand:
    """A device set up for one check.

    Attributes
    ----------
    make : Callable[..., Any]
        Constructs an unconnected driver that reaches the device through ``proxies``; keyword arguments are further options.
    use : Callable[[Any], None]
        One ordinary operation with a connected driver; raises AssertionError if its result is not what the device did.
    wrong : Callable[[], Any] or None
        Constructs a driver that expects another device.
    begin : Callable[[Any], None] or None
        Starts something that takes long (a motion, a scan), and returns once it is under way; it may block until that ends.
    at_rest : Callable[[], bool] or None
        Whether the device itself says that nothing moves.
    ready : Callable[[], bool]
        Whether it takes a new driver, where it needs a while after a fault.
    short_limits : Mapping[str, Any]
        Options with short time limits, given where a fault is waited for; all else runs with the limits of ``make``, so that a busy
        computer fails nobody.
    output : tuple[int, Callable[[], bool]] or None
        Number of a digital output that a robot switches under the option digital_outputs, and whether the device itself says that it is on.
    facts : Mapping[str, Callable[[], object]]
        By the name of each fact of the driver, what changes it at the device while the driver is connected; it also cuts the connection,
        where the device tells it only when one begins.
    """

    make: Callable[..., Any]
    use: Callable[[Any], None]
    proxies: Mapping[str, Proxy] = field(default_factory=dict)
    wrong: Callable[[], Any] | None = None
    begin: Callable[[Any], None] | None = None
    at_rest: Callable[[], bool] | None = None
    short_limits: Mapping[str, Any] = field(default_factory=dict)
    ready: Callable[[], bool] = lambda: True
    output: tuple[int, Callable[[], bool]] | None = None
    facts: Mapping[str, Callable[[], object]] = field(default_factory=dict)


@dataclass(frozen=True)
class DriverBench:
    """A driver under the conformance checks.

    Attributes
    ----------
    name : str
        Name of the driver, and how it is connected.
    kind : str
        Robot, scanner, positioner or sensor.
    open : Callable[[], AbstractContextManager[Stand]]
        Sets a Stand up.
    limit_s : float
        Time that no single step of a check may exceed, here and on the device's own account (generous).
    excused : Mapping[str, str]
        Check -> why this driver cannot be asked for it.
    """

    name: str
    kind: str
    open: Callable[[], AbstractContextManager[Stand]]
    limit_s: float = 20.0
    excused: Mapping[str, str] = field(default_factory=dict)

    @property
    def protocol(self) -> type:
        return PROTOCOLS[self.kind]
