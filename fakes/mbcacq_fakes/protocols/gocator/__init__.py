"""A Gocator at the wire: every command answered, data and health published, discovery if asked for, faults to inject."""

from mbcacq_fakes.protocols.gocator.faults import FAULTS
from mbcacq_fakes.protocols.gocator.options import FakeGocatorOptions
from mbcacq_fakes.protocols.gocator.server import FakeGocator

__all__ = ["FAULTS", "FakeGocator", "FakeGocatorOptions"]
