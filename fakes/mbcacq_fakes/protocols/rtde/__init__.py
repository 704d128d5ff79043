"""A Universal Robots controller at the wire: RTDE, an arm that moves, and what can go wrong with both."""

from mbcacq_fakes.protocols.rtde.controller import FAULTS as FAULTS
from mbcacq_fakes.protocols.rtde.controller import FakeUrController as FakeUrController
from mbcacq_fakes.protocols.rtde.controller import start_in_cell as start_in_cell
