"""A fake LMI sensor that runs GoPxL: control over MessagePack, data over GDP, discovery."""

from mbcacq_fakes.protocols.gopxl.server import FakeGoPxL as FakeGoPxL
from mbcacq_fakes.protocols.gopxl.server import FakeGoPxLOptions as FakeGoPxLOptions
