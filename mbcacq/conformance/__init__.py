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

from mbcacq.conformance.bounded import Hang as Hang
from mbcacq.conformance.bounded import bounded as bounded
from mbcacq.conformance.checks import CHECKS as CHECKS
from mbcacq.conformance.driver_bench import DriverBench as DriverBench
from mbcacq.conformance.driver_bench import Stand as Stand
from mbcacq.conformance.faults import ACTIONS as ACTIONS
from mbcacq.conformance.faults import Channel as Channel
from mbcacq.conformance.faults import Fault as Fault
from mbcacq.conformance.faults import as_read as as_read
from mbcacq.conformance.faults import counted as counted
from mbcacq.conformance.faults import ended as ended
from mbcacq.conformance.injection import Case as Case
from mbcacq.conformance.injection import InjectionVerdict as InjectionVerdict
from mbcacq.conformance.injection import cases as cases
from mbcacq.conformance.injection import inject as inject
from mbcacq.conformance.injection import survey as survey
from mbcacq.conformance.proxy import Proxy as Proxy
from mbcacq.conformance.proxy import TcpProxy as TcpProxy
from mbcacq.conformance.proxy_pty import PtyProxy as PtyProxy
from mbcacq.conformance.proxy_udp import UdpProxy as UdpProxy
from mbcacq.conformance.run import CheckResult as CheckResult
from mbcacq.conformance.run import check as check
from mbcacq.conformance.run import run as run
from mbcacq.conformance.steps import Skip as Skip
