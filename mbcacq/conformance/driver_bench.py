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

    make: constructs an unconnected driver that reaches the device through ``proxies``; keyword arguments are further options.
    use: one ordinary operation with a connected driver; raises AssertionError if its result is not what the device did.
    wrong: constructs a driver that expects another device. begin: starts something that takes long (a motion, a scan), and returns
    once it is under way; it may block until that ends. at_rest: whether the device itself says that nothing moves. ready: whether it
    takes a new driver, where it needs a while after a fault. short_limits: options with short time limits, given where a fault is waited
    for; all else runs with the limits of ``make``, so that a busy computer fails nobody. output: number of a digital output that a robot
    switches under the option digital_outputs, and whether the device itself says that it is on.
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


@dataclass(frozen=True)
class DriverBench:
    """name: of the driver, and how it is connected. kind: robot, scanner, positioner or sensor. open: sets a Stand up.

    limit_s: what no single step of a check may exceed, here and on the device's own account (generous). excused: check -> why this
    driver cannot be asked for it.
    """

    name: str
    kind: str
    open: Callable[[], AbstractContextManager[Stand]]
    limit_s: float = 20.0
    excused: Mapping[str, str] = field(default_factory=dict)

    @property
    def protocol(self) -> type:
        return PROTOCOLS[self.kind]
