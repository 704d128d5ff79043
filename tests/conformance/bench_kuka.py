"""The KUKA drivers, over RSI and over EKI, in front of fake controllers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.resources import files
from typing import Any

import numpy as np
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.krc.server import FakeEkiController, FakeKrc
from mbcacq_kuka.eki.driver import KukaEki
from mbcacq_kuka.rsi.driver import KukaRsi

from mbcacq.conformance import Channel, Stand, TcpProxy, UdpProxy, ended
from mbcacq.devices import MotionLimits

LIMITS_DEG = [(-185, 185), (-140, 10), (-120, 168), (-350, 350), (-125, 125), (-350, 350)]
HOME_DEG = np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])
EKI_LIMITS_DEG = [(-5, 5), (-95, -85), (85, 95), (-5, 5), (-5, 5), (-5, 5)]  # as in the data list that is shipped
EKI_HOME_DEG = np.array([0.0, -90.0, 90.0, 0.0, 1.0, 0.0])
SPEED_DEG_S = (200.0, 175.0, 190.0, 430.0, 430.0, 630.0)
OUTPUT = 3
XML = ended(b"</Robot>")


def limits(speed: float = 60.0) -> MotionLimits:
    return MotionLimits(*(np.radians(np.full(6, v)) for v in (speed, 400.0, 4000.0)), tolerance=2e-4, settle_s=0.05)


def moves(home: np.ndarray, where: Callable[[], np.ndarray]) -> Callable[[Any], None]:
    """Away from home, or back; and it must really be there. where: the arm's true joint angles, deg."""

    def use(robot: Any) -> None:
        away = np.degrees(robot.state().q) - home
        target = home if np.abs(away).max() > 0.5 else home + [1.5, 0, -1.0, 0, 0, 0]
        robot.move_to(np.radians(target), limits())
        deadline = time.monotonic() + 600.0
        while not robot.state().arrived:
            assert time.monotonic() < deadline, "the arm never arrived, and nobody said so"
            time.sleep(0.002)
        there = where()
        assert np.abs(there - target).max() < 0.02, f"'arrived', but the arm is at {there}, not at {target}"

    return use


@contextmanager
def kuka_rsi(**krc: Any) -> Iterator[Stand]:
    with ExitStack() as stack:
        port = free_port()
        proxies: dict[str, Any] = {"rsi": stack.enter_context(UdpProxy(Channel("rsi"), ("127.0.0.1", port)))}
        given: dict[str, Any] = {"limits_deg": LIMITS_DEG, "port": port, "silence_s": 15.0}
        fake = stack.enter_context(
            FakeKrc(
                client=proxies["rsi"].address,
                realtime=False,
                limits_deg=LIMITS_DEG,
                start_deg=tuple(HOME_DEG),
                rearm_s=0.3,
                digital_outputs=(OUTPUT,),
                **krc,
            )
        )
        made = []

        def make(model: str = "KR 16 R2010-2", **options: Any) -> KukaRsi:
            made.append(KukaRsi("arm", model, {**given, **options}))
            return made[-1]

        def begin(robot: KukaRsi) -> None:
            robot.move_to(np.radians(HOME_DEG + [60.0, 0, 0, 0, 0, 0]), limits())

        stack.callback(lambda: [robot.close() for robot in made])
        use = moves(HOME_DEG, lambda: np.degrees(fake.state.read().q))
        yield Stand(
            make=make,
            use=use,
            proxies=proxies,
            begin=begin,
            at_rest=lambda: fake.state.read().standstill,
            short_limits={"silence_s": 0.8, "connect_timeout_s": 1.5},
            ready=lambda: not fake.report()["active"],
            output=(OUTPUT, lambda: fake.state.output(OUTPUT)[0]),
            facts={name: partial(fake.inject, **{name.replace("load", "load_kg"): 9.0}) for name in ("load", "tool", "base")},
        )


@contextmanager
def kuka_eki() -> Iterator[Stand]:
    """The programs that are shipped, run by a fake controller."""
    folder = files("mbcacq_kuka") / "controller"
    sources = {name: (folder / "eki_kss" / name).read_text() for name in ("mbcacq_eki.dat", "mbcacq_eki.src", "mbcacq_link.src")}
    sources["mbcacq_eki.dat"] = sources["mbcacq_eki.dat"].replace("mb_out[1]=0", f"mb_out[1]={OUTPUT}")
    with ExitStack() as stack:
        fake = stack.enter_context(
            FakeEkiController(
                sources=sources, channel=(folder / "eki_kss" / "mbcacq_eki.xml").read_text(), start_deg=tuple(EKI_HOME_DEG), realtime=False
            )
        )
        proxy = stack.enter_context(TcpProxy(Channel("eki"), ("127.0.0.1", fake.port), cut=XML, cut_driver=ended(b"</Command>")))
        given = {
            "address": "127.0.0.1",
            "port": proxy.port,
            "limits_deg": EKI_LIMITS_DEG,
            "speed_deg_s": SPEED_DEG_S,
            "silence_s": 15.0,
            "reconnect_s": 15.0,
            "connect_timeout_s": 20.0,
        }
        made = []

        def make(model: str = "KR 10 R1100-2", **options: Any) -> KukaEki:
            made.append(KukaEki("arm", model, {**given, **options}))
            return made[-1]

        def begin(robot: KukaEki) -> None:
            robot.move_to(np.radians(EKI_HOME_DEG + [4.9, 0, 0, 0, 0, 0]), limits(2.0))

        stack.callback(lambda: [robot.close() for robot in made])
        yield Stand(
            make,
            moves(EKI_HOME_DEG, lambda: np.degrees(fake.state.read().q)),
            {"eki": proxy},
            lambda: make("KR 210 R2700-2"),
            begin,
            lambda: fake.state.read().standstill,
            {"silence_s": 1.2, "connect_timeout_s": 1.0, "reconnect_s": 0.5},
            output=(OUTPUT, lambda: fake.state.output(OUTPUT)[0]),
            facts={"load": lambda: fake.inject(load_kg=9.0), "override": lambda: fake.inject(override=50)},
        )
