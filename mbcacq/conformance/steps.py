"""What several checks do: change the messages, look whether the device rests, and whether the next driver works."""

from __future__ import annotations

from typing import Any

from mbcacq.conformance.bounded import bounded, demand, eventually, outcome
from mbcacq.conformance.driver_bench import DriverBench, Stand


class Skip(Exception):
    """The check does not apply to this bench; the message says why."""


def fault(bench: DriverBench, stand: Stand, action: str, must_fail: bool = False) -> None:
    """From the next message on, whatever the device sends is changed: on connecting, and in the middle of the work."""
    need_proxies(stand)
    for moment in ("connect", "use"):
        # A busy computer may make the connection to a device that answers a slow one.
        limits = {name: limit for name, limit in stand.short_limits.items() if moment == "connect" or name != "connect_timeout_s"}
        driver = stand.make(**limits)
        if moment == "use":
            bounded("connect", driver.connect, bench.limit_s)
        for proxy in stand.proxies.values():
            proxy.channel.set(action, lasting=True)
        step = driver.connect if moment == "connect" else lambda d=driver: stand.use(d)
        error = outcome(f"{moment} under '{action}'", step, bench.limit_s)
        if must_fail and error is None and moment == "connect":
            error = outcome("use", lambda d=driver: stand.use(d), bench.limit_s)
        demand(error is not None or not must_fail, f"{moment}: a device that says nothing goes unnoticed")
        bounded("stop", driver.stop, bench.limit_s)
        bounded("close", driver.close, bench.limit_s)
        for proxy in stand.proxies.values():
            proxy.channel.heal()
        rests(bench, stand)
        works_anew(bench, stand)


def segments(bench: DriverBench, stand: Stand, action: str) -> None:
    streams = [proxy for proxy in stand.proxies.values() if proxy.stream]
    if not streams:
        raise Skip("no link of this device is a stream")
    for proxy in streams:
        proxy.channel.set(action, lasting=True)
    works(bench, stand, stand.make())
    demand(any(proxy.channel.struck for proxy in streams), "no message passed the proxies")


def works(bench: DriverBench, stand: Stand, driver: Any, times: int = 1) -> None:
    """A driver connects, is used so many times, and closes, each within the limit."""
    bounded("connect", driver.connect, bench.limit_s)
    for _ in range(times):
        bounded("use", lambda: stand.use(driver), bench.limit_s)
    bounded("close", driver.close, bench.limit_s)


def works_anew(bench: DriverBench, stand: Stand) -> None:
    """Whatever was, the next driver finds a device that works."""
    comes_back(bench, stand)
    driver = stand.make()
    bounded("connect, afterwards", driver.connect, bench.limit_s)
    try:
        bounded("use, afterwards", lambda: stand.use(driver), bench.limit_s)
    finally:
        bounded("close, afterwards", driver.close, bench.limit_s)


def comes_back(bench: DriverBench, stand: Stand) -> None:
    """After a cut the links are made anew, and the device hears of its lost driver, in their own time."""
    eventually(lambda: all(proxy.ready for proxy in stand.proxies.values()), bench.limit_s, "the link did not come back")
    eventually(stand.ready, bench.limit_s, "the device does not take a new driver")


def rests(bench: DriverBench, stand: Stand) -> None:
    if stand.at_rest is not None:
        eventually(stand.at_rest, bench.limit_s, "the device did not come to rest")


def need_proxies(stand: Stand) -> None:
    if not stand.proxies:
        raise Skip("there is no link in which anything could happen to a message")
