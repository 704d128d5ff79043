"""A robot controller's OPC UA server at the wire, made by asyncua's own server, with the companion nodes for robots."""

from mbcacq_fakes.protocols.opcua.server import FAULTS as FAULTS
from mbcacq_fakes.protocols.opcua.server import FakeOpcUaServer as FakeOpcUaServer
from mbcacq_fakes.protocols.opcua.server import start_in_cell as start_in_cell
