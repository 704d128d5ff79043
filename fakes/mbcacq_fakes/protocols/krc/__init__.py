"""Fake KUKA controllers: RSI over UDP, and EKI over TCP with the KRL programs of the controller, an arm behind each."""

from mbcacq_fakes.protocols.krc.eki_server import FakeEkiController
from mbcacq_fakes.protocols.krc.server import FakeKrc

__all__ = ["FakeEkiController", "FakeKrc"]
