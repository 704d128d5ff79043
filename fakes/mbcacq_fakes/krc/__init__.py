"""A fake KUKA controller: RSI over UDP and EKI over TCP, with an arm behind it, in a process of its own."""

from mbcacq_fakes.krc.server import FakeKrc

__all__ = ["FakeKrc"]
