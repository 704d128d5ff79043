"""What the tool asks of a device, and how a driver is found.

A driver is any class with these few methods, registered under one of the entry-point groups ``mbcacq.robots``,
``mbcacq.scanners``, ``mbcacq.positioners``, ``mbcacq.sensors``. It is constructed as ``Driver(name, model, options)``
(see ``create``) and must not open anything before ``connect``. All calls are synchronous; ``stop`` may come from
another thread at any time, any number of times.

Units: mm, rad, s unless a field says otherwise. A driver imports this package and nothing else of mbcacq.
"""

from __future__ import annotations

from mbcacq.devices.addresses import HOST as HOST
from mbcacq.devices.addresses import is_host as is_host
from mbcacq.devices.addresses import is_loopback as is_loopback
from mbcacq.devices.addresses import is_own_address as is_own_address
from mbcacq.devices.bounded_xml import parse_xml as parse_xml
from mbcacq.devices.child_process import ChildEnded as ChildEnded
from mbcacq.devices.child_process import ChildProcess as ChildProcess
from mbcacq.devices.child_process import kill as kill
from mbcacq.devices.deferred_signals import signals_deferred as signals_deferred
from mbcacq.devices.life_cycle import ContextDevice as ContextDevice
from mbcacq.devices.model_names import same_model as same_model
from mbcacq.devices.motion_target import joint_target as joint_target
from mbcacq.devices.plan_options import DriverOptions as DriverOptions
from mbcacq.devices.plan_options import parse_options as parse_options
from mbcacq.devices.protocols import Cycles as Cycles
from mbcacq.devices.protocols import Description as Description
from mbcacq.devices.protocols import Device as Device
from mbcacq.devices.protocols import Fact as Fact
from mbcacq.devices.protocols import Field as Field
from mbcacq.devices.protocols import MotionLimits as MotionLimits
from mbcacq.devices.protocols import Positioner as Positioner
from mbcacq.devices.protocols import Profiles as Profiles
from mbcacq.devices.protocols import ProfileScanner as ProfileScanner
from mbcacq.devices.protocols import Robot as Robot
from mbcacq.devices.protocols import RobotState as RobotState
from mbcacq.devices.protocols import Scan as Scan
from mbcacq.devices.protocols import Scanner as Scanner
from mbcacq.devices.protocols import Sensor as Sensor
from mbcacq.devices.registry import available as available
from mbcacq.devices.registry import create as create
from mbcacq.devices.registry import load_driver as load_driver
from mbcacq.devices.tcp import LinkLost as LinkLost
from mbcacq.devices.tcp import TcpLink as TcpLink
from mbcacq.devices.tcp import hang_up as hang_up
from mbcacq.devices.tcp import has_ended as has_ended
from mbcacq.devices.tcp import open_tcp as open_tcp
from mbcacq.devices.tcp import reason as reason
from mbcacq.devices.terminal_input import is_interactive as is_interactive
from mbcacq.devices.terminal_input import typed_line as typed_line
from mbcacq.errors import Aborted as Aborted
from mbcacq.errors import ConfigError as ConfigError
from mbcacq.errors import ConnectError as ConnectError
from mbcacq.errors import DeviceFault as DeviceFault
from mbcacq.errors import DeviceTimeout as DeviceTimeout
from mbcacq.errors import IdentityError as IdentityError
from mbcacq.errors import MbcacqError as MbcacqError
from mbcacq.errors import ProtocolError as ProtocolError
from mbcacq.errors import SafetyStop as SafetyStop
from mbcacq.errors import SystemRefused as SystemRefused
