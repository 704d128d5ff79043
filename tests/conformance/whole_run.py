"""A whole run of a small plan, its devices behind proxies: what one faulty message does to the recording and its centres.

Two cells: KUKA over RSI with a Gocator, and KUKA over EKI with a GoPxL sensor, a lift on Modbus TCP and a thermometer on a serial line.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.bus.serial_sensor import FakeSerialSensor
from mbcacq_fakes.protocols.stall import STALL_S

from mbcacq.conformance import Case, Channel, InjectionVerdict, Proxy, TcpProxy, UdpProxy, bounded, counted, ended
from mbcacq.conformance.bounded import Hang, eventually, sentence
from mbcacq.conformance.injection import NAMED, RECOVERED, UNREACHED
from mbcacq.devices import MbcacqError, load_driver
from mbcacq.plan import expand, load
from mbcacq.recording import load_observations as load_recording
from mbcacq.workflow import acquire

PLANS = Path(__file__).resolve().parents[2] / "plans"
LIMIT_S, NOISE_MM = 180.0, 0.15  # a ball's centre scatters by 0.01 mm; the next pose's is 10 mm away
HASTY = {"timeout_s": 2.0, "reply_limit_s": 2.0, "connect_timeout_s": 2.0}


LIFT = {
    "driver": "modbus",
    "options": {
        "host": "192.168.1.20",
        "identity": {"where": {"address": 100}, "equals": 4711},
        "stations": {"p1": 1, "p2": 2},
        "position": {"address": 10, "type": "uint16"},
        "in_position": {"address": 3, "table": "discrete"},
        "actual": {"address": 20, "table": "input", "type": "int16"},
        "tolerance": 0.5,
        "move_timeout_s": 20.0,
    },
}
THERMOMETER = {
    "driver": "serial",
    "options": {"port": "/dev/ttyUSB0", "ask": "READ?\r\n", "line": "T=(?P<air_C>[-+0-9.]+)", "units": {"air_C": "C"}},
}
AIR_C = 20.5
BUSES = "EKI, GoPxL, Modbus, serial"


def small_plan(folder: Path, cell: str = "") -> Path:
    """Four poses of the quick plan, one exposure each; of the cell ``BUSES`` two of them at a second station."""
    plan = yaml.safe_load((PLANS / "quick.yaml").read_text())
    plan["robot"]["model"] = str(PLANS / plan["robot"]["model"])
    plan["artefacts"] = [str(PLANS / a) for a in plan["artefacts"]]
    plan["exposures"] = 1
    plan["steps"] = plan["steps"][1:]
    if cell == BUSES:
        plan["robot"] |= {"driver": "kuka-eki", "options": {"address": "127.0.0.1", "port": 54610, "mode": "any", "reconnect_s": 2.0}}
        plan["scanner"]["driver"] = "gopxl"
        plan |= {"positioner": LIFT, "sensors": [THERMOMETER]}
        plan["stations"].append({"id": "p2", "artefact": "mbc", "pose_in_base": {"translation_mm": [560, 160, 120], "abc_deg": [20, 0, 0]}})
        plan["steps"][0] |= {"stations": ["p1", "p2"], "views": plan["steps"][0]["views"][:2]}
    else:
        plan["steps"][0]["views"] = plan["steps"][0]["views"][:4]
        plan["fake"] = {"robot": {"answer_wait_s": [STALL_S, 0.01]}}  # a lost answer is not one of a computer that hangs
    plan["robot"]["options"]["silence_s"] = 1.5
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump(plan, sort_keys=False))
    return path


@contextmanager
def cell(loaded: Any, poses: list[Any]) -> Iterator[tuple[Any, dict[str, dict[str, Any]], dict[str, Proxy]]]:
    """The fake cell with proxies in front: (cell, overrides for the drivers, proxies)."""
    with ExitStack() as stack:
        fake = stack.enter_context(load_driver("fakes", "cell")(loaded, poses, realtime=False, seed=3))
        overrides = fake.overrides()
        scanner, robot = overrides["scanner"], overrides["robot"]
        proxies: dict[str, Proxy] = {}

        def before(link: str, host: str, port: int, **cuts: Any) -> int:
            proxies[link] = stack.enter_context(TcpProxy(Channel(link), (host, port), **cuts))
            return int(proxies[link].port)

        for option in [name for name in scanner if name.endswith("_port")]:
            link = option.removesuffix("_port")
            scanner[option] = before(link, scanner["address"], scanner[option], cut=counted(), cut_driver=counted())
        if loaded.plan.positioner.driver == LIFT["driver"]:
            robot["port"] = before("eki", robot["address"], robot["port"], cut=ended(b"</Robot>"), cut_driver=ended(b"</Command>"))
            lift, mbap = overrides["positioner"], counted(at=4, size=2, order="big", plus=6)
            lift["port"] = before("modbus", lift["host"], lift["port"], cut=mbap, cut_driver=mbap)
            meter = stack.enter_context(FakeSerialSensor(lambda: "", answers={"READ?": f"T={AIR_C:.2f}"}))
            meter.silent = True
            port = before("serial", *meter.address, cut=ended(b"\n"), cut_driver=ended(b"\n"))
            overrides["sensor 1"] = {"port": f"socket://127.0.0.1:{port}", "timeout_s": 1.0}
        else:
            free = free_port()
            proxies["rsi"] = stack.enter_context(UdpProxy(Channel("rsi"), ("127.0.0.1", free), port=robot["port"]))
            robot["port"] = free
        overrides["scanner"] = {**scanner, **HASTY}
        yield fake, overrides, proxies


class Wrong(Exception):
    """Result and detail of a run that did not end as it should."""


class WholeRun:
    """``centres`` of the undisturbed run by (pose, ball): (3,) mm; ``counts`` of its messages."""

    def __init__(self, which: str = "") -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="whole-"))
        self._loaded = load(small_plan(self._folder, which))
        self._poses = expand(self._loaded)
        with cell(self._loaded, self._poses) as (_, overrides, proxies):
            self._execute(overrides, "undisturbed")
            self.counts = {(link, sender): n for link, proxy in proxies.items() for sender, n in proxy.channel.count.items()}
        self.centres = self._centres("undisturbed")
        assert len({pose for pose, _ in self.centres}) == len(self._poses)

    def close(self) -> None:
        shutil.rmtree(self._folder)

    def inject(self, case: Case) -> InjectionVerdict:
        """A run with one fault, and whether what it recorded is what the undisturbed run recorded."""
        began = time.monotonic()
        try:
            result, detail = self._verdict(case, "run")
        except Wrong as wrong:
            result, detail = wrong.args
        return InjectionVerdict(case, result, detail, time.monotonic() - began)

    def _verdict(self, case: Case, name: str) -> tuple[str, str]:
        shutil.rmtree(self._folder / name, ignore_errors=True)
        with cell(self._loaded, self._poses) as (fake, overrides, proxies):
            proxies[case.link].channel.set(case.action, case.sender, index=case.index, seconds=3.0)
            error = self._error_of_run(case, overrides, name)
            struck = proxies[case.link].channel.struck
            try:
                eventually(lambda: fake.arm.read().standstill, 10.0, "the arm did not come to rest")
            except AssertionError as moving:
                raise Wrong("not at rest", str(moving)) from moving
        self._compare(name, error)
        if error is not None:
            return NAMED, f"{type(error).__name__}: {error}"
        return (RECOVERED if struck else UNREACHED), ""

    def _error_of_run(self, case: Case, overrides: dict[str, dict[str, Any]], name: str) -> MbcacqError | None:
        """The named error in which the run ended, None if it ended well."""
        try:
            bounded(str(case), lambda: self._execute(overrides, name), LIMIT_S)
        except Hang as hang:
            raise Wrong("hang", str(hang)) from hang
        except MbcacqError as error:
            sentence(error)
            return error
        except Exception as foreign:
            raise Wrong("wrong", f"{type(foreign).__name__}: {foreign}") from foreign
        return None

    def _compare(self, name: str, error: MbcacqError | None) -> None:
        try:
            found = self._centres(name)
        except MbcacqError as unread:
            if error is None or "no " not in str(unread):
                raise Wrong("unreadable", str(unread)) from unread
            found = {}
        strange = [
            f"pose {pose} ball {ball}"
            for (pose, ball), xyz in found.items()
            if (pose, ball) not in self.centres or np.abs(xyz - self.centres[pose, ball]).max() > NOISE_MM
        ]
        if strange:
            raise Wrong("wrong", f"centres of {', '.join(strange[:4])} are not those of the undisturbed run")
        if found and (read := [t for t in self._temperatures(name) if t != AIR_C]):
            raise Wrong("wrong", f"a temperature of {read[0]:g} C was read where {AIR_C:g} was sent")
        # Poses, not balls: a ball at the edge may be found in one scan and not in the next.
        if error is None and {pose for pose, _ in found} != {pose for pose, _ in self.centres}:
            raise Wrong("wrong", f"the run ended well without some of its poses ({len(found)} of {len(self.centres)} centres)")

    def _execute(self, overrides: dict[str, dict[str, Any]], name: str) -> None:
        run = acquire.plan_acquisition(self._loaded, self._poses, frozenset(), 0, "the fake cell of seed 3")
        run.folder = self._folder / name
        run.folder.mkdir()
        run.execute(overrides)

    def _temperatures(self, name: str) -> list[float]:
        return [float(t) for values in load_recording(self._folder / name).temperatures.values() for t in values if np.isfinite(t)]

    def _centres(self, name: str) -> dict[tuple[int, int], np.ndarray]:
        recorded = load_recording(self._folder / name)
        ids, balls = recorded.pose_id, recorded.cell.ball_ids
        return {(int(ids[p]), int(balls[b])): xyz for p, b, xyz in zip(recorded.pose, recorded.ball, recorded.xyz, strict=True)}
