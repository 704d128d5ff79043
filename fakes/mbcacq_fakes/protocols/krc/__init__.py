"""Fake KUKA controllers: RSI over UDP, and EKI over TCP with the KRL programs of the controller, an arm behind each."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbcacq_fakes.protocols.krc.eki_server import FakeEkiController
    from mbcacq_fakes.protocols.krc.server import FakeKrc

__all__ = ["FakeEkiController", "FakeKrc"]


def __getattr__(name: str) -> object:
    """Loaded where asked for: the controller's own process, which begins with this package, needs none of their libraries."""
    if name == "FakeKrc":
        from mbcacq_fakes.protocols.krc.server import FakeKrc

        return FakeKrc
    if name == "FakeEkiController":
        from mbcacq_fakes.protocols.krc.eki_server import FakeEkiController

        return FakeEkiController
    raise AttributeError(f"module {__name__} has no attribute {name}")
