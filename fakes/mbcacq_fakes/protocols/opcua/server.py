"""A controller's OPC UA server: asyncua's, in a thread, and an arm that a person moves."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Mapping, Sequence
from datetime import UTC
from typing import Any, Self

import numpy as np
from asyncua import ua
from asyncua.server.server import Server
from asyncua.ua.status_codes import StatusCodes

from mbcacq_fakes.protocols.faults import refuse_unknown
from mbcacq_fakes.protocols.opcua.address_space import ArmNodes, build, served
from mbcacq_fakes.protocols.started import Started

TICK_S = 0.02
CLOCK_START_S = 1000.0
LED_RAD_S = 1.0
HURRIED = 10.0  # in a dry run: times faster than the clock
FAULTS = {
    "bad": "the angle of this axis (1..) is marked as bad",
    "not_a_number": "the angle of this axis is NaN",
    "frozen": "the angles stay what they were",
}


class FakeOpcUaServer(Started):
    """Context manager. start_deg: where the arm stands; state: gets what it does, or None; realtime: a person's speed; arm: its nodes."""

    def __init__(
        self,
        state: Any = None,
        *,
        start_deg: Sequence[float] = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0),
        realtime: bool = False,
        host: str = "127.0.0.1",
        port: int = 0,
        arm: ArmNodes | None = None,
    ) -> None:
        self.q = np.radians(np.array(start_deg, dtype=float))
        self._goal, self._direction, self._arrivals = self.q.copy(), np.zeros(len(self.q)), 0
        self._state, self._pace, self._host, self.port = state, 1.0 if realtime else HURRIED, host, port
        self.arm = arm or ArmNodes(names=tuple(f"Axis_{k}" for k in range(1, len(self.q) + 1)), profiles=(1,) * len(self.q))
        self._faults: dict[str, int] = {}
        self._changed: dict[str, Any] = {}
        self._quit, self._ready = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="fake-opcua", daemon=True)
        self.time_s = CLOCK_START_S
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)

    def lead(self, target: np.ndarray) -> None:
        """A person brings the arm to ``target`` (n,) rad; from any thread."""
        self._goal = np.asarray(target, dtype=float)

    def inject(self, **faults: int) -> None:
        """See FAULTS; 0 takes one back. Raises ValueError."""
        refuse_unknown(faults, FAULTS)
        self._faults |= faults

    def report(self, **values: Any) -> None:
        """Somebody sets these at the controller: Mass (kg), Model, SerialNumber."""
        self._changed |= values

    def start(self) -> Self:
        """Returns when it listens. Raises OSError if the port is taken."""
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise self._error
        return self

    def stop(self) -> None:
        self._quit.set()
        if self._thread.is_alive():
            self._thread.join(10.0)

    def _work(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._error = error
        finally:
            self._ready.set()

    async def _serve(self) -> None:
        server = Server()
        await server.init()
        server.set_endpoint(f"opc.tcp://{self._host}:{self.port}/")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        positions = await build(server, self.arm)
        await self._show(server, positions)
        async with server:
            self.port = port_of(server)
            self._ready.set()
            last = time.monotonic()
            while not self._quit.is_set():
                await asyncio.sleep(TICK_S)
                now = time.monotonic()
                self._advance(self._pace * (now - last))
                last = now
                await self._show(server, positions)

    def _advance(self, seconds: float) -> None:
        self.time_s += seconds
        away = self._goal - self.q
        step = np.clip(away, -LED_RAD_S * seconds, LED_RAD_S * seconds)
        moving = bool(np.abs(away).max() > 1e-12)
        if moving:
            self._arrivals += int(np.abs(away - step).max() < 1e-12)
            self._direction = np.where(np.abs(step) > 1e-12, np.sign(step), self._direction)
        self.q = self.q + step
        if self._state is not None:
            self._state.write(
                self.time_s,
                tuple(self.q.tolist()),
                tuple((step / max(seconds, 1e-9)).tolist()),
                tuple(self._direction.tolist()),
                not moving,
                self._arrivals,
            )

    async def _show(self, server: Server, positions: Sequence[Any]) -> None:
        for name in list(self._changed):
            value = self._changed.pop(name)
            await self.arm.values[name].write_value(ua.LocalizedText(value) if name == "Model" else value)
        if self._faults.get("frozen"):
            return
        for axis, (node, value) in enumerate(zip(positions, served(np.degrees(self.q).tolist(), self.arm), strict=True), 1):
            shown = float("nan") if self._faults.get("not_a_number") == axis else value
            code = StatusCodes.BadSensorFailure if self._faults.get("bad") == axis else StatusCodes.Good
            variant = ua.Variant(shown, ua.VariantType.Double)
            await server.write_attribute_value(node.nodeid, ua.DataValue(variant, ua.StatusCode(ua.UInt32(code)), ua.DateTime.now(UTC)))


def port_of(server: Server) -> int:
    """The port at which a started server listens; it was free to take any."""
    listening: Any = server.bserver
    return listening._server.sockets[0].getsockname()[1]


def start_in_cell(
    state: Any, *, start_deg: Sequence[float], realtime: bool, ports: str, plan_options: Mapping[str, Any], **given: Any
) -> tuple[FakeOpcUaServer, dict[str, Any]]:
    """For the fake cell: a running server, and the options that lead the driver to it."""
    names = tuple(plan_options.get("axes") or (f"Axis_{k}" for k in range(1, len(start_deg) + 1)))
    payload = plan_options.get("payload_kg")
    model = plan_options.get("expect_model") or "a robot"
    arm = ArmNodes(model=model, names=names, profiles=(1,) * len(names), payload_kg=2.3 if payload is None else float(payload))
    port = 0 if ports == "free" else int(plan_options.get("port", 4840))
    fake = FakeOpcUaServer(state, start_deg=start_deg, realtime=realtime, port=port, arm=arm).start()
    plain = {"user": None, "password_env": None, "security": None, "path": "", "arm": None, "silence_s": 30.0}
    return fake, {
        "address": "127.0.0.1",
        "port": fake.port,
        "rate_hz": 50.0,
        "controller_matrix": None,
        "controller_offset_deg": None,
        **plain,
    }
