"""A conformance suite for drivers: give it a bench (your driver, its device or a fake behind proxies), get a list of results.

    from mbcacq.conformance import DriverBench, Channel, Stand, TcpProxy, run

    @contextmanager
    def open():
        with MyFake() as fake, TcpProxy(Channel("line"), fake.address) as proxy:
            yield Stand(make=lambda **more: MyDriver("x", "m1", {"port": proxy.port, **more}), use=one_reading,
                        proxies={"line": proxy}, wrong=lambda: MyDriver("x", "another", {"port": proxy.port}))

    for result in run(DriverBench("mine", "sensor", open)):
        print(result)

Needs no test framework. docs/conformance.md says what each check asks for.
"""

from mbcacq.conformance.bounded import Hang, bounded
from mbcacq.conformance.checks import CHECKS
from mbcacq.conformance.driver_bench import DriverBench, Stand
from mbcacq.conformance.faults import ACTIONS, Channel, Fault, as_read, counted, ended
from mbcacq.conformance.injection import Case, InjectionVerdict, cases, inject, survey
from mbcacq.conformance.proxy import Proxy, TcpProxy
from mbcacq.conformance.proxy_pty import PtyProxy
from mbcacq.conformance.proxy_udp import UdpProxy
from mbcacq.conformance.run import CheckResult, check, run
from mbcacq.conformance.steps import Skip

__all__ = [
    "ACTIONS",
    "CHECKS",
    "DriverBench",
    "Case",
    "Channel",
    "Fault",
    "Hang",
    "Proxy",
    "PtyProxy",
    "CheckResult",
    "Skip",
    "Stand",
    "TcpProxy",
    "UdpProxy",
    "InjectionVerdict",
    "as_read",
    "bounded",
    "cases",
    "check",
    "counted",
    "ended",
    "inject",
    "run",
    "survey",
]
