"""``python -m acme_probe.conformance``: the driver against the fake thermometer, by all checks that a driver must pass."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from acme_probe import AcmeProbe
from acme_probe.fake import FakeProbe
from mbcacq.conformance import Channel, DriverBench, Stand, TcpProxy, ended, run


@contextmanager
def opened() -> Iterator[Stand]:
    """The driver behind a proxy, which harms what is sent, in front of the fake."""
    with FakeProbe() as probe, TcpProxy(Channel("line"), probe.address, cut=ended(b"\n"), cut_driver=ended(b"\n")) as proxy:

        def use(sensor: AcmeProbe) -> None:
            got = sensor.read()
            assert got == {"air_C": probe.answers[-1]}, f"it reads {got}, the probe answered {probe.answers[-1:]}"

        def make(model: str = "T-1000", **more: Any) -> AcmeProbe:
            return AcmeProbe("air", model, {"address": "127.0.0.1", "port": proxy.port, **more})

        yield Stand(make, use, {"line": proxy}, wrong=lambda: make("T-2000"), short_limits={"timeout_s": 0.3})


BENCH = DriverBench("acme_probe", "sensor", opened)

if __name__ == "__main__":
    for result in run(BENCH):
        print(result)
