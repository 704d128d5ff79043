"""Parsers of what devices send: KUKA, Gocator, GoPxL, Modbus, serial lines."""

from __future__ import annotations

import struct
from functools import cache

import msgpack
import numpy as np
from fuzz_target import Target
from mbcacq_bus.modbus_connection import Connection
from mbcacq_bus.modbus_link import ModbusLink
from mbcacq_bus.registers import Register
from mbcacq_bus.serial import SerialSensor
from mbcacq_fakes.protocols.gocator import channel, encode
from mbcacq_fakes.protocols.gocator.discovery import Discovery
from mbcacq_fakes.protocols.gocator.options import FakeGocatorOptions, Ports
from mbcacq_fakes.protocols.gocator.state import SensorState
from mbcacq_fakes.protocols.gopxl import encode as gdp_encode
from mbcacq_fakes.protocols.krc.wire import RobTemplate
from mbcacq_gocator import control, dataset, decode, health, information, points, selection, wire
from mbcacq_gocator.configuration import Configuration
from mbcacq_gocator.discovery import parse_reply
from mbcacq_gocator.gopxl import frames, gdp, tree
from mbcacq_gocator.gopxl.points import points_of
from mbcacq_kuka.eki import telegrams
from mbcacq_kuka.eki.framing import Cutter
from mbcacq_kuka.rsi.telegram import Parser, finite
from pymodbus.client import ModbusTcpClient

from mbcacq.errors import MbcacqError


class Stub:
    """A socket that has received ``data`` and whose other end is closed."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def recv_into(self, view: memoryview) -> int:
        part = self._data[self._at : self._at + len(view)]
        view[: len(part)] = part
        self._at += len(part)
        return len(part)

    def settimeout(self, seconds: float) -> None:
        pass


# KUKA


def rob(**quirks: bool) -> bytes:
    template = RobTemplate(("RIst", "AIPos", "ASPos", "MACur", "Delay"), 6, **quirks)
    return template.finish(template.body([1.5] * 24 + [0]), 1000124)


def rsi(data: bytes) -> None:
    parser = Parser(data)
    digits, row = parser.parse(data)
    finite(row)
    int(digits)
    parser.slots("AIPos", ("A1", "A2"))


STEADY = Parser(rob())


def rsi_later(data: bytes) -> None:
    digits, row = STEADY.parse(data)
    assert len(row) == len(STEADY.names)
    int(digits)


HELLO = (
    b'<Robot><Hello Axes="6" Interface="mbcacq 1" MachineData="V8.6.11" Model="#KR10R1100_2 C4 SV" Session="3" LoadKg="5.0">'
    + b"".join(
        b'<%s X="0.0" Y="1.0" Z="-2.5" A="0.0" B="0.0" C="0.0"></%s>' % (n, n)
        for n in (b"BaseFrame", b"ToolFrame", b"RobRoot", b"LoadCentre")
    )
    + b"</Hello></Robot>"
)
STATE = (
    b"<Robot><State "
    + b" ".join(b'%s="1"' % n.encode() for n in sorted(telegrams._INTEGERS.values()))
    + b">"
    + b"".join(
        b"<%s %s></%s>" % (n, b" ".join(b'%s="1.5"' % a.encode() for a in names), n)
        for n, names in ((b"Axis", telegrams.AXES), (b"Cart", telegrams.POSE), (b"Current", telegrams.AXES))
    )
    + b"</State></Robot>"
)


def eki_stream(data: bytes) -> None:
    cutter = Cutter("Robot")
    third = len(data) // 3 + 1
    for start in range(0, len(data), third):
        for telegram in cutter.feed(data[start : start + third]):
            telegrams.parse(telegram)


# Gocator

SHORT_CFG = b"""<?xml version='1.0' encoding='UTF-8'?>
<Configuration version="101">
  <Setup>
    <ScanMode options="0,2,3">3</ScanMode>
    <Trigger><Source options="0,1,3">3</Source></Trigger>
    <Devices><Device role="0" index="0"><ExposureMode>0</ExposureMode><Exposure min="10" max="100000" used="1">1000.0</Exposure></Device></Devices>
  </Setup>
</Configuration>
"""


@cache
def gocator_seeds() -> dict[str, tuple[bytes, ...]]:
    from bench_gocator import tilted_plane

    frame = tilted_plane()
    sets = [
        encode.data_set(
            frame, encode.DataSetHeader(exposure_us=900.0, ticks=5000, index=3, serial=12345, uniform=uniform, generation=generation)
        )
        for generation in (4, 5, 6)
        for uniform in (False, True)
    ]
    state = SensorState(FakeGocatorOptions())
    request = struct.pack("<QQQQ", 32, 5, 0x0000504455494D4C, 0)
    discovery = Discovery(state, Ports(3190, 3194, 3196), port=0)
    try:
        answers = (discovery.answer(request), discovery.answer(request[:8] + b"\x01" + request[9:]))
    finally:
        discovery.close()
    replies = tuple(
        channel.reply_to(state, number, payload)
        for number, payload in (
            (0x4511, b""),
            (0x4010, b""),
            (0x4002, b""),
            (0x4525, b""),
            (0x101A, bytes(64)),
            (0x4512, b""),
            (0x100A, b""),
        )
    )
    return {
        "messages": tuple({bytes(m) for each in sets for m in each}),
        "sets": tuple(b"".join(each) for each in sets),
        "discovery": answers,
        "replies": replies,
        "health": (bytes(encode.health({(2002, 0): 41, (2404, 1): 45, (20005, 0): 7})),),
        "cfg": (SHORT_CFG,),
    }


def gocator_message(data: bytes) -> None:
    message, _ = decode.decode(data)
    if isinstance(message, decode.ArrayMessage):
        surface = points.surface_points(message)
        assert len(surface.points) == len(surface.pixel) <= surface.shape[0] * surface.shape[1]


def gocator_set(data: bytes) -> None:
    found = dataset.read_set(wire.MessageReader(Stub(data), "scan"), float("inf"))
    if (surface := selection.scan_surface(found.arrays)) is not None:
        points.surface_points(surface)


def gocator_health(data: bytes) -> None:
    message, _ = decode.decode(data)
    if isinstance(message, decode.Health):
        health.named(message.items)


def gocator_reply(data: bytes) -> None:
    *_, body = control._read_reply("reply", Stub(data), float("inf"))
    for parse in (information.parse_info_1, information.parse_info_2, information.parse_states):
        try:
            parse(body)
        except MbcacqError:
            pass


def gocator_configuration(data: bytes) -> None:
    found = Configuration(data)
    _ = found.trigger_source, found.exposure_us
    found.set_exposure(1000.0)
    Configuration(found.values_only())


# GoPxL


@cache
def gopxl_seeds() -> tuple[bytes, ...]:
    """Data sets of a stamp, a surface and a measurement."""
    from bench_gocator import tilted_plane

    out = []
    for uniform in (False, True):
        kind = gdp_encode.UNIFORM_SURFACE if uniform else gdp_encode.SURFACE_POINTS
        bodies = (
            (gdp_encode.STAMP, gdp_encode.stamp(3, 12.5)),
            (kind, gdp_encode.surface(tilted_plane(), uniform, True, 900.0)),
            (gdp_encode.MEASUREMENT, gdp_encode.measurement(1.25)),
        )
        out.append(b"".join(gdp_encode.message(k, gdp_encode.common("a:b", 1, i == 2, i), body) for i, (k, body) in enumerate(bodies)))
    return tuple(out)


def gopxl_set(data: bytes) -> None:
    found = gdp.read_set(wire.MessageReader(Stub(data), "scan"), float("inf"))
    if found.surface is not None:
        points_of(found.surface)


def gopxl_reply(data: bytes) -> None:
    frames.reply_size(data[: frames.REPLY.size].ljust(frames.REPLY.size, b"\0"))
    found = frames.content(data[frames.REPLY.size :])
    tree.children(found)
    tree.outputs(found)
    tree.data_sources(found)


def gopxl_reply_seed() -> bytes:
    body = msgpack.packb(
        {"type": "reply", "payload": {"outputs": [{"id": 1, "source": "a"}], "_links": {"item": [{"href": "/x"}]}, "n": 1.5}}
    )
    return frames.REPLY.pack(frames.REPLY.size + len(body), frames.MESSAGE_PACK, 1, len(body)) + body


# bus


class Client(ModbusTcpClient):
    """Has received ``data`` behind the number of its own request."""

    data = b""

    def connect(self) -> bool:
        return True

    def send(self, request: bytes, addr: object = None) -> int:
        self.waiting = request[:2] + self.data
        return len(request)

    def recv(self, size: int | None) -> bytes:
        data, self.waiting = self.waiting, b""
        return data

    def close(self) -> None:
        pass


class OpenTransport:
    """A connection that stays open and brings nothing unasked."""

    is_open = True

    def __init__(self, client: Client) -> None:
        self.client = client

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass

    def discard(self) -> int:
        return 0

    def wait_for_silence(self, *limits: object) -> tuple[int, bool]:
        return 0, True


LINK = ModbusLink("lift", Connection(host="127.0.0.1", timeout_s=0.01, retries=0))
CLIENT = Client("127.0.0.1", timeout=0.01, retries=0)
FLOAT, BIT = Register(address=4, type="float32"), Register(address=3, table="discrete")


def modbus(data: bytes) -> None:
    Client.data, LINK._transport = data, OpenTransport(CLIENT)
    CLIENT.transaction.count_until_disconnect = 5
    LINK.read(BIT if data[5:6] in (b"\x02", b"\x82") else FLOAT)


THERMOMETER = SerialSensor("thermo", "T2", {"port": "socket://127.0.0.1:1", "line": r"T=(?P<air_C>[-+0-9.eE]+) H=(?P<humidity>\S+)"})


def serial_line(data: bytes) -> None:
    for line in (piece.decode("ascii", "replace").strip() for piece in data.split(b"\n")):
        if THERMOMETER._pattern.fullmatch(line):
            assert all(np.isfinite(list(THERMOMETER._numbers(line).values())))


def wire_targets() -> list[Target]:
    """All of them."""
    seeds = gocator_seeds()
    words = struct.unpack(">2H", struct.pack(">f", 38.25))
    modbus_seeds = (
        struct.pack(">HHBBB2H", 0, 7, 1, 3, 4, *words),
        struct.pack(">HHBBBB", 0, 4, 1, 2, 1, 1),
        struct.pack(">HHBBB", 0, 3, 1, 0x83, 2),
    )
    return [
        Target("rsi telegram, first", (rob(), rob(spaced=True), rob(swap=True, upper_type=True)), rsi),
        Target("rsi telegram, later", (rob(), rob(spaced=True), rob(swap=True)), rsi_later),
        Target("eki stream and telegrams", (HELLO, STATE, HELLO + b"\0 x>y" + STATE, STATE + STATE), eki_stream),
        Target("gocator message", seeds["messages"], gocator_message),
        Target("gocator data set", seeds["sets"], gocator_set),
        Target("gocator health", seeds["health"], gocator_health),
        Target("gocator reply", seeds["replies"], gocator_reply),
        Target("gocator discovery", seeds["discovery"], parse_reply),
        Target("gocator configuration", seeds["cfg"], gocator_configuration),
        Target("modbus reply", modbus_seeds, modbus),
        Target("serial line", (b"T=21.50 H=40\n", b"T=-1e3 H=nan\nT=1 H=2\n"), serial_line),
        Target("gopxl data set", gopxl_seeds(), gopxl_set),
        Target("gopxl reply", (gopxl_reply_seed(),), gopxl_reply),
    ]
