"""The fake sensor: its state, its clock, its exposures, and the channels in front of it."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np

from mbcacq_fakes.protocols.gocator import channel, encode
from mbcacq_fakes.protocols.gocator.discovery import PORT, Discovery, outward_address
from mbcacq_fakes.protocols.gocator.exposures import EXPOSURE, TICKS_PER_S, Exposures
from mbcacq_fakes.protocols.gocator.faults import Faults
from mbcacq_fakes.protocols.gocator.files import Files
from mbcacq_fakes.protocols.gocator.listener import Listener
from mbcacq_fakes.protocols.gocator.publish import Publisher
from mbcacq_fakes.protocols.gocator.replies import INVALID_STATE, UNKNOWN_COMMAND, CommandRefused
from mbcacq_fakes.world.frame import ScannerFrame

Source = Callable[[float], ScannerFrame]
_FIRMWARE = {4: (4, 8, 2, 29), 5: (5, 3, 23, 10), 6: (6, 1, 32, 12)}
_PROTOCOL = {4: (101, 4), 5: (101, 10), 6: (101, 11)}


class Ports(NamedTuple):
    control: int
    health: int
    data: int


class FakeGocator:
    """``source(exposure_us)`` is called once an exposure, in a thread of the fake, and returns the world's Frame.

    scan_time_s: how long an exposure takes. clock: the world's time in s; without it the sensor counts from its start.
    With a clock, ``ScannerFrame.time_s`` becomes the stamp; without, the moment of the exposure does. generation: 4, 5 or 6, the
    firmware whose message layouts are used. volume: (low, high) (3,) mm of the measuring volume, by default each frame's own.
    """

    def __init__(
        self,
        source: Source,
        *,
        host: str = "127.0.0.1",
        control_port: int = 0,
        health_port: int = 0,
        data_port: int = 0,
        discovery: bool = False,
        discovery_port: int = PORT,
        broadcast: str = "255.255.255.255",
        model: str = "3210",
        serial: int = 12345,
        part_number: str = "",
        scan_time_s: float = 0.0,
        jobs: tuple[str, ...] = ("bench.job", "other.job"),
        generation: int = 6,
        intensity: bool = True,
        uniform: bool = False,
        clock: Callable[[], float] | None = None,
        volume: tuple[np.ndarray, np.ndarray] | None = None,
        health_period_s: float = 1.0,
    ) -> None:
        self.source, self.host, self.serial, self.scan_time_s = source, host, serial, scan_time_s
        self._model, self._part_number = model, part_number
        self.generation, self.firmware, self.protocol = generation, _FIRMWARE[generation], _PROTOCOL[generation]
        self.volume, self.health_period_s = volume, health_period_s
        self.files = Files(tuple(jobs), {"Setup/IntensityEnabled": intensity, "Setup/UniformSpacingEnabled": uniform})
        self.faults = Faults()
        self.settings = dict.fromkeys(("alignment_reference", "recording", "playback_source", "autostart", "quick_edit"), 0)
        self.variables, self.flags, self.encoder = [0, 0, 0, 0], {}, 0
        self.temperature_C = 41.0
        self.indicators: dict[tuple[int, int], int] = {}  # further ones, by number and instance
        self.running = False
        self.ready = threading.Event()
        self.data, self.health = Publisher(), Publisher()
        self.clock, self._born = clock, time.monotonic()
        self._wanted = (host, control_port, health_port, data_port)
        self._discovery_wanted = (discovery, discovery_port, broadcast)
        self._operation = 0
        self._controls: dict[socket.socket, threading.Thread] = {}
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._exposures = Exposures(self, self._closing)
        self._listeners: list[Listener] = []
        self._threads: list[threading.Thread] = []
        self._discovery: Discovery | None = None

    def start(self) -> Self:
        host, *ports = self._wanted
        takers = (self._accept_control, lambda s: self.health.add(s, self._health()), self.data.add)
        try:
            for port, take in zip(ports, takers, strict=True):
                self._listeners.append(Listener(host, port, take, lambda: bool(self.faults.get("refuse_connections"))))
            self.ports = Ports(*(listener.port for listener in self._listeners))
            if self._discovery_wanted[0]:
                self._discovery = Discovery(self, *self._discovery_wanted[1:])
        except OSError:
            self.stop()
            raise
        self._threads = [threading.Thread(target=run, name="fake-gocator", daemon=True) for run in (self._exposures.run, self._pulse)]
        for starter in (*self._listeners, *self._threads, *filter(None, [self._discovery])):
            starter.start()
        self.ready.set()
        return self

    def stop(self) -> None:
        """Idempotent; returns when all threads and sockets are gone."""
        self._closing.set()
        self.ready.clear()
        for listener in self._listeners:
            listener.close()
        if self._discovery is not None:
            self._discovery.close()
        self.drop_connections()
        with self._lock:
            threads = [*self._threads, *self._controls.values()]
        for thread in threads:
            thread.join(5.0)
        self._listeners, self._threads, self._discovery = [], [], None

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    @property
    def model(self) -> str:
        return self.faults.get("model") or self._model

    @property
    def part_number(self) -> str:
        return self._part_number or f"31{self.model}A-2-R-01-T"

    @property
    def address(self) -> str:
        return self.host if self.host not in ("", "0.0.0.0") else outward_address()

    @property
    def discovery_port(self) -> int | None:
        """Udp port on which discovery answers, None while it is switched off."""
        return self._discovery.port if self._discovery else None

    @property
    def scans(self) -> int:
        """Exposures made so far."""
        return self._exposures.made

    @property
    def uptime_s(self) -> float:
        return time.monotonic() - self._born

    def ticks(self) -> int:
        """The sensor's clock in the unit of time stamps."""
        return int((self.clock() if self.clock else self.uptime_s) * TICKS_PER_S)

    def begin(self) -> None:
        """Command start."""
        with self._lock:
            if self.running:
                raise CommandRefused(INVALID_STATE)
            self.running = True

    def halt(self) -> None:
        """Command stop, allowed in any state."""
        with self._lock:
            self.running = False

    def snapshot(self) -> None:
        if self.generation < 5:
            raise CommandRefused(UNKNOWN_COMMAND)
        if self.running:
            raise CommandRefused(INVALID_STATE)
        self._exposures.ask()

    def trigger(self) -> None:
        if not self.running:
            raise CommandRefused(INVALID_STATE)
        self._exposures.ask()

    def reboot(self) -> None:
        """Three seconds after the reply all connections end and the sensor is ready again."""

        def later() -> None:
            if not self._closing.wait(3.0):
                self.running = False
                self.drop_connections()

        threading.Thread(target=later, name="fake-gocator-reboot", daemon=True).start()

    def operate(self, alignment: bool) -> int:
        """Alignment or automatic exposure: the number of the operation; its result follows on the data channel."""
        with self._lock:
            self._operation += 1
            number = self._operation
        if alignment:
            self.data.publish([encode.operation_result(encode.ALIGNMENT_RESULT, number)])
        else:
            exposure = int(self.files.number(EXPOSURE)).to_bytes(4, "little")
            self.data.publish([encode.operation_result(encode.EXPOSURE_RESULT, number, exposure)])
        return number

    def drop_connections(self) -> None:
        """Close every connection of every client; new ones are welcome."""
        with self._lock:
            controls = list(self._controls)
        for sock in controls:
            try:
                sock.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
        self.data.close()
        self.health.close()

    def _accept_control(self, sock: socket.socket) -> None:
        def serve() -> None:
            with sock:
                channel.serve(self, sock)
            with self._lock:
                self._controls.pop(sock, None)

        thread = threading.Thread(target=serve, name="fake-gocator-control", daemon=True)
        with self._lock:
            self._controls[sock] = thread
        thread.start()

    def _pulse(self) -> None:
        while not self._closing.wait(self.health_period_s):
            self.health.publish(self._health())

    def _health(self) -> list[bytearray]:
        if self.faults.get("mute_health"):
            return []
        major, minor, release, build = self.firmware
        values = {
            (20000, 0): int(self.running),
            (2000, 0): major << 24 | minor << 16 | release << 8 | build,
            (2017, 0): int(self.uptime_s),
            (2002, 0): round(self.temperature_C),
            (2404, 0): round(self.temperature_C) + 4,
            (1003, 0): self.encoder,
            (20005, 0): self.scans,
            (2007, 0): 12,
            **self.indicators,
        }
        return [encode.health(values)]
