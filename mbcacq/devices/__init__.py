"""What the tool asks of a device, and how a driver is found.

A driver is any class with these few methods, registered under one of the entry-point groups ``mbcacq.robots``,
``mbcacq.scanners``, ``mbcacq.positioners``, ``mbcacq.sensors``. It is constructed as ``Driver(name, model, options)``
(see ``create``) and must not open anything before ``connect``. All calls are synchronous; ``stop`` may come from
another thread at any time, any number of times.

Units: mm, rad, s unless a field says otherwise. A driver imports this package and nothing else of mbcacq.
"""

from __future__ import annotations

from mbcacq.devices.addresses import HOST, is_host, is_loopback
from mbcacq.devices.child_process import ChildEnded, ChildProcess, kill
from mbcacq.devices.deferred_signals import signals_deferred
from mbcacq.devices.life_cycle import ContextDevice
from mbcacq.devices.model_names import same_model
from mbcacq.devices.motion_target import joint_target
from mbcacq.devices.plan_options import DriverOptions, parse_options
from mbcacq.devices.protocols import (
    Cycles,
    Description,
    Device,
    Fact,
    Field,
    MotionLimits,
    Positioner,
    Profiles,
    ProfileScanner,
    Robot,
    RobotState,
    Scan,
    Scanner,
    Sensor,
)
from mbcacq.devices.registry import available, create, load_driver
from mbcacq.devices.tcp import LinkLost, TcpLink, hang_up, has_ended, open_tcp, reason
from mbcacq.devices.terminal_input import is_interactive, typed_line
from mbcacq.errors import (
    Aborted,
    ConfigError,
    ConnectError,
    DeviceFault,
    DeviceTimeout,
    IdentityError,
    MbcacqError,
    ProtocolError,
    SafetyStop,
    SystemRefused,
)

__all__ = [
    "HOST",
    "Aborted",
    "ChildEnded",
    "ChildProcess",
    "ConfigError",
    "ConnectError",
    "ContextDevice",
    "Cycles",
    "Description",
    "Device",
    "DeviceFault",
    "DeviceTimeout",
    "DriverOptions",
    "Fact",
    "Field",
    "IdentityError",
    "LinkLost",
    "MbcacqError",
    "MotionLimits",
    "Positioner",
    "ProfileScanner",
    "Profiles",
    "ProtocolError",
    "Robot",
    "RobotState",
    "SafetyStop",
    "Scan",
    "Scanner",
    "Sensor",
    "SystemRefused",
    "TcpLink",
    "available",
    "create",
    "hang_up",
    "has_ended",
    "is_host",
    "is_loopback",
    "is_interactive",
    "joint_target",
    "kill",
    "load_driver",
    "open_tcp",
    "parse_options",
    "reason",
    "same_model",
    "signals_deferred",
    "typed_line",
]
