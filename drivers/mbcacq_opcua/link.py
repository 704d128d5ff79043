"""The conversation with the server, in a thread of its own: the robot is found, then its joint angles are read again and again."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from datetime import datetime
from typing import Any

from asyncua import ua
from asyncua.client.client import Client
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.object_ids import ObjectIds

from mbcacq.devices import ConfigError, ConnectError, DeviceFault, DeviceTimeout, IdentityError, MbcacqError, ProtocolError, same_model
from mbcacq_opcua.nodes import UNITS, NoSuchRobot, RobotNodes, find_robot
from mbcacq_opcua.options import OpcUaOptions

CLOCK = ua.NodeId(ua.Int32(ObjectIds.Server_ServerStatus_CurrentTime))
STARTED = ua.NodeId(ua.Int32(ObjectIds.Server_ServerStatus_StartTime))
RETRY_S = 0.1
Reading = Callable[[float, list[float]], None]

logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what is wrong is said by our errors, once


@asynccontextmanager
async def _within(seconds: float) -> AsyncIterator[None]:
    """As asyncio.timeout, which does not know the exception in which a request of asyncua ends that is answered while it is cancelled."""
    limit = asyncio.timeout(seconds)
    try:
        async with limit:
            yield
    except asyncio.CancelledError as error:
        if limit.expired():
            raise TimeoutError from error
        raise


class OpcUaLink:
    """``on_reading(time_s, angles)`` is called with every reading: seconds since the server's start, by its clock, and angles in its own
    units; ``on_error`` with what ended the conversation. Only read, browse and session services are used.

    A connection that the server has closed is opened again within the time after which it counts as lost. The robot must be the same, of a
    server that was not started again.
    """

    def __init__(self, name: str, options: OpcUaOptions, on_reading: Reading, on_error: Callable[[MbcacqError], None]) -> None:
        self._name, self._options, self._on_reading, self._on_error = name, options, on_reading, on_error
        self._quit, self._ready = threading.Event(), threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None
        self._thread: threading.Thread | None = None
        self._started: datetime | None = None
        self._heard = 0.0  # when the last reading came, time.monotonic
        self.robot: RobotNodes | None = None
        self.states: dict[str, str] = {}
        self.facts: dict[str, Any] = {}  # the last good value of what is watched

    def connect(self) -> None:
        """Returns once the robot was found, or ``on_error`` was called. Raises ConfigError if the password is missing."""
        self._client()  # made once more where it is used; what the plan lacks is said here
        self._thread = threading.Thread(target=self._work, name="opcua", daemon=True)
        self._thread.start()
        self._ready.wait()

    def close(self) -> None:
        """Idempotent, from any thread."""
        self._quit.set()
        loop, task = self._loop, self._task
        if loop is not None and task is not None:
            with suppress(RuntimeError):  # the loop has ended already
                loop.call_soon_threadsafe(task.cancel)
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(5.0)

    def _client(self) -> Client:
        o = self._options
        client = Client(o.url, timeout=max(o.connect_timeout_s, o.silence_s))  # of a request; the narrower limits are ours
        if o.user is not None:
            client.set_user(o.user)
        if o.password_env is not None:
            password = os.environ.get(o.password_env)
            if password is None:
                raise ConfigError(f"{self._name}: the environment variable {o.password_env} is not set; it must hold the password")
            client.set_password(password)
        return client

    def _work(self) -> None:
        try:
            asyncio.run(self._converse())
        except asyncio.CancelledError:
            pass
        except Exception as error:
            if not self._quit.is_set():
                self._on_error(error if isinstance(error, MbcacqError) else self._named(error))
        finally:
            self._ready.set()

    async def _converse(self) -> None:
        self._loop, self._task = asyncio.get_running_loop(), asyncio.current_task()
        within_s = self._options.connect_timeout_s
        while not self._quit.is_set():
            try:
                await self._read_on(self._client(), within_s)
            except ConnectionError:
                within_s = self._heard + self._options.silence_s - time.monotonic()
                if not self._ready.is_set() or within_s <= 0:
                    raise
                await asyncio.sleep(min(RETRY_S, within_s))

    async def _read_on(self, client: Client, within_s: float) -> None:
        """Connect, and read until that fails. within_s: until the first reading."""
        o = self._options
        try:
            async with _within(within_s):
                if o.security is not None:
                    await client.set_security_string(o.security)
                await client.connect()
                self.robot = await self._find(client)
                await self._read(client)
            self._ready.set()
            while True:
                await asyncio.sleep(1.0 / o.rate_hz)
                async with _within(o.silence_s):
                    await self._read(client)
        finally:
            with suppress(Exception):
                async with _within(min(1.0, o.silence_s)):
                    await client.disconnect()
            client.disconnect_socket()

    async def _find(self, client: Client) -> RobotNodes:
        try:
            found = await find_robot(client, len(self._options.limits_deg), self._options.arm, self._options.axes)
        except NoSuchRobot as error:
            raise ConfigError(f"{self._place} {error}") from error
        self._check(found)
        started = await client.get_node(STARTED).read_value()
        if not isinstance(started, datetime):
            raise ProtocolError(f"{self._place} does not say when it was started; is its OPC UA server up to date?")
        if (self._started or started) != started:
            raise DeviceFault(f"{self._place}: the server was started again, and its clock with it; resume the run")
        if self.robot is not None and self.robot.about != found.about:
            raise IdentityError(f"{self._place}: another robot answers since the connection was lost; look at the cables, then resume")
        self._started = started
        for what, node in found.safety.items():
            value = await node.read_value()
            self.states[what] = getattr(value, "name", str(value))
        return found

    def _check(self, found: RobotNodes) -> None:
        o, model = self._options, found.about.get("Model", "")
        if o.expect_model is not None and not same_model(o.expect_model, model):
            raise IdentityError(f"{self._place} is a '{model}', not a '{o.expect_model}'; correct the address or the option expect_model")
        strange = next(((a, u) for a, u in zip(found.names, found.units, strict=True) if u not in UNITS.values()), None)
        if strange is not None and o.angle_unit is None:
            axis, unit = strange
            says = f"states '{unit}' as unit of axis '{axis}', which is not known here" if unit else f"states no unit of axis '{axis}'"
            raise ConfigError(f"{self._place} {says}; look at the values and give the option angle_unit: deg or rad")
        if o.payload_kg is None:
            return
        if found.payload_kg is None or abs(found.payload_kg - o.payload_kg) > o.payload_tolerance_kg:
            has = "none" if found.payload_kg is None else f"{found.payload_kg:.2f} kg"
            raise ConfigError(f"{self._place} has a flange load of {has}, the plan says {o.payload_kg:.2f} kg; set it on the controller")

    async def _read(self, client: Client) -> None:
        """One request for all axes, the clock and what is watched. Raises DeviceFault for an angle that the server marks as bad."""
        robot = self.robot
        assert robot is not None, "it was found before it is read"
        nodes = [*(p.nodeid for p in robot.positions), CLOCK, *(node.nodeid for node in robot.watched.values())]
        values = await client.uaclient.read_attributes(nodes, AttributeIds.Value)
        values, watched = values[: len(robot.positions) + 1], values[len(robot.positions) + 1 :]
        for axis, value in zip(robot.names, values, strict=False):
            if value.StatusCode is not None and not value.StatusCode.is_good():
                raise DeviceFault(
                    f"{self._place} marks the angle of '{axis}' as {value.StatusCode.name}; look at the controller's messages"
                )
        *angles, clock = [None if value.Value is None else value.Value.Value for value in values]
        numbers = [float(a) for a in angles if isinstance(a, int | float)]
        if not isinstance(clock, datetime) or len(numbers) < len(angles):
            raise ProtocolError(f"{self._place} sends angles or a time that are no numbers; is its OPC UA server up to date?")
        assert self._started is not None, "it was found before it is read"
        self._heard = time.monotonic()
        for name, found in zip(robot.watched, watched, strict=False):
            if found.Value is not None and found.Value.Value is not None and (found.StatusCode is None or found.StatusCode.is_good()):
                self.facts[name] = found.Value.Value
        self._on_reading((clock - self._started).total_seconds(), numbers)

    @property
    def _place(self) -> str:
        return f"{self._name} at {self._options.address}:{self._options.port}"

    def _named(self, error: Exception) -> MbcacqError:
        """The library's error as one of ours; on broken bytes it may raise anything."""
        begun, why = self._ready.is_set(), str(error) or type(error).__name__
        if isinstance(error, ua.UaError) and not isinstance(error, ConnectionError):
            if begun:
                return ProtocolError(f"{self._place}: the server refuses to be read ({why}); look at the controller's messages")
            return ConnectError(f"{self._place}: the server refuses ({why}); check user, password_env and security, and its certificates")
        if isinstance(error, TimeoutError | ConnectionError | OSError):
            if begun:
                return DeviceTimeout(f"{self._place} was lost ({why}); check controller and cable")
            return ConnectError(f"{self._place} does not answer ({why}); is its OPC UA server on, are address and port right?")
        return ProtocolError(f"{self._place} sends what is no OPC UA ({why}); is it another service's port?")
