"""A Universal Robots controller at the wire: RTDE, an arm that moves, and what can go wrong with both."""

from mbcacq_fakes.protocols.rtde.controller import FAULTS, FakeUrController, start_in_cell

__all__ = ["FAULTS", "FakeUrController", "start_in_cell"]
