"""A Gocator at the wire: every command answered, data and health published, discovery if asked for, faults to inject."""

from mbcacq_fakes.protocols.gocator.faults import FAULTS as FAULTS
from mbcacq_fakes.protocols.gocator.options import FakeGocatorOptions as FakeGocatorOptions
from mbcacq_fakes.protocols.gocator.server import FakeGocator as FakeGocator
