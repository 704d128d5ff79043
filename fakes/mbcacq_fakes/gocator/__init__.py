"""A Gocator at the wire: every command answered, data and health published, discovery if asked for, faults to inject."""

from mbcacq_fakes.gocator.faults import FAULTS, Faults
from mbcacq_fakes.gocator.server import FakeGocator

__all__ = ["FAULTS", "FakeGocator", "Faults"]
