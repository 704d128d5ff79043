"""A robot controller's OPC UA server at the wire, made by asyncua's own server, with the companion nodes for robots."""

from mbcacq_fakes.protocols.opcua.server import FAULTS, FakeOpcUaServer, start_in_cell

__all__ = ["FAULTS", "FakeOpcUaServer", "start_in_cell"]
