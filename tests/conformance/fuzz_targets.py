"""Every parser of bytes from outside, with valid inputs to start from. ``run(data)`` ends in a value or one of our errors, or it is a bug."""

from __future__ import annotations

import atexit
import json
import os
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import msgpack
import numpy as np
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
from mbcacq_kuka.eki.framing import Cutter, FramingError
from mbcacq_kuka.rsi.telegram import Malformed, Parser, finite
from pymodbus.client import ModbusTcpClient

from mbcacq.errors import MbcacqError
from mbcacq.exports.certificate import read_certificate
from mbcacq.exports.result_json import load_result
from mbcacq.files.table import read_table
from mbcacq.plan import yaml_source
from mbcacq.recording.datasets import csv_columns
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.datasets.observation_set import _read_centres, _read_poses, read_observation_set
from mbcacq.recording.rrd.checked_lines import checked_line, read_lines
from mbcacq.recording.rrd.checksums import read_stretches
from mbcacq.recording.run_folder.gaps import find_gaps
from mbcacq.recording.run_folder.run_plan import plan_files_text, read_kept_plan
from mbcacq.report.sources.from_result import content_of
from mbcacq.spheres.ply import read_cloud

OURS = (MbcacqError, Malformed, FramingError, telegrams.BadTelegram)  # the last three become ProtocolError one call above
MEMORY = os.environ.get("XDG_RUNTIME_DIR") or ("/dev/shm" if os.path.isdir("/dev/shm") else None)


@dataclass(frozen=True)
class Target:
    name: str
    seeds: tuple[bytes, ...]
    parse: Callable[[bytes], object]

    def run(self, data: bytes) -> bool:
        """True if it was accepted, False if refused with one of our errors; anything else passes."""
        try:
            self.parse(data)
        except OURS:
            return False
        return True


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
    *_, body = control._read_reply(Stub(data), "reply", float("inf"))
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
            (kind, gdp_encode.surface(tilted_plane(), uniform, True, 900.0, True)),
            (gdp_encode.MEASUREMENT, gdp_encode.measurement(1.25, True)),
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
    for line in data.split(b"\n"):
        THERMOMETER._take(line.decode("ascii", "replace").strip())
    assert all(np.isfinite(list(THERMOMETER._values.values())))


# files

POSES = b"""pose,station,phase,time_s,q1_deg,q2_deg,dir1,dir2,air_C,note
0,1,position,0.5,10.5,-20.25,1,-1,21.5,first
1,far,hold-out,4.5,-10.0,2e1,0,1,21.75,"a, b"
"""
CENTRES = b"""pose,ball,x_mm,y_mm,z_mm,n_points,rms_mm,qx,qy,qz,qw
0,1,1.5,-2.25,0.001,200,0.01,0,0,0,1
0,2,30.5,1e-3,5,180,0.012,0,0,0,1
1,7,.5,40,-5,170,0.009,0.5,0.5,0.5,0.5
"""
CELL = b"""format: mbcacq-observation-set/1
robot:
  name: two axes
  repeatability_mm: 0.02
  links:
    - {sign: -1, theta_deg: 0, d_mm: 400, a_mm: 25, alpha_deg: -90, gear_ratio: 119.2, mass_kg: 20}
    - {sign: 1, theta_deg: 0, d_mm: 0, a_mm: 560, alpha_deg: 0}
hand_eye: {abc_deg: [10, 20, 30], translation_mm: [1.5, -2.25, 240]}
artefacts:
  - id: mbc
    balls: [{id: 1, centre_mm: [0, 0, 0], diameter_mm: 12}, {id: 2, centre_mm: [30, 0, 5], diameter_mm: 12},
            {id: 7, centre_mm: [0, 40, -5], diameter_mm: 12}]
stations: [{id: 1, artefact: mbc}, {id: far, artefact: mbc}]
scanner: {name: made, noise_mm: [0.005, 0.005, 0.009]}
"""
SET = {"poses.csv": POSES, "centres.csv": CENTRES, "cell.yaml": CELL}
LISTED = b"label,x_mm,y_mm,z_mm,d_mm,U_mm,k,T_C\n1,0.5,-2,3e1,12.001,0.002,2,20.0\n2,10,0,0,12,0.002,2,20.0\n"
LISTED_HERE = "\ufeffBall;X (mm);Y (mm);Z (mm);Diameter (mm)\nK1;0,5;-2;30;12,001\nK2;10;0;0;12\n".encode()
BALLS = b"id: mbc\nT_C: 20\nuncertainty_mm: 0.001\nballs:\n  - {label: K1, centre_mm: [0, 0.5, 3], diameter: 12}\n  - {label: K2, centre_mm: [1, 2, 3], diameter: 12}\n"
DMIS = b"""DMISMN/'certificate'
UNITS/MM,ANGDEC
$$ a comment
FA(BALL 1)=FEAT/SPHERE,OUTER,CART,0.5,-2.0,$
30.0,12.001
FA(BALL 2)=FEAT/SPHERE,OUTER,CART,10,0,0,12
"""
PLY_HEAD = "ply\nformat {} 1.0\ncomment made\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
PLYS = (
    PLY_HEAD.format("ascii").encode() + b"0 0 0\n1 2.5 -3\n1e-3 4 5\n",
    PLY_HEAD.format("binary_little_endian").encode() + struct.pack("<9f", *range(9)),
    PLY_HEAD.format("binary_big_endian").encode() + struct.pack(">9f", *range(9)),
)
PLAN = b"""format: mbcacq-plan/1
name: made     # a comment
steps:
  - {name: look, poses: [[0, -90, 90, 0, 0, 0], [1.5, -90, 90, 0, 0, 0]]}
  - &again {name: "quoted \\u00e4", count: 12}
  - *again
text: |
  several
  lines
"""


def in_file(name: str, read: Callable[[Path], object], other_files: dict[str, bytes] | None = None) -> Callable[[bytes], object]:
    """A parser that reads a file, in memory where the system has it. The file stands alone, or in a folder with others."""
    made = tempfile.TemporaryDirectory(prefix="fuzz-", dir=MEMORY)
    atexit.register(made.cleanup)
    for other, data in (other_files or {}).items():
        (Path(made.name) / other).write_bytes(data)
    path = Path(made.name) / name

    def parse(data: bytes) -> object:
        path.write_bytes(data)
        return read(path)

    return parse


JOURNAL = b"".join(
    checked_line(entry)
    for entry in (
        {
            "time_s": 0.0,
            "event": "run_started",
            "name": "made",
            "started": "2026-01-02T03:04:05+00:00",
            "n_poses": 3,
            "versions": {"numpy": "2"},
        },
        {"time_s": 1.5, "event": "pose_done", "pose": 0, "station": "1", "balls": 8, "robot_time_s": 12.5},
        {"time_s": 1.6, "event": "gap", "kind": "pose", "text": "pose 1 was left out", "pose": 1},
        {"time_s": 2.0, "event": "run_stopped", "exit_status": "fail", "reason": "a wall"},
    )
)
CHECKSUMS = checked_line({"file": "run.rrd", "start": 0, "end": 512, "poses": [1, 2], "sha256": "00" * 32}) * 2
AXES_OF = {name: [0.1, 0.2] for name in ("theta", "d", "a", "alpha", "beta")}
FRAME = [[1, 0, 0, 1.5], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
RESULT = json.dumps(
    {
        "format": "mbcacq-result/1",
        "method": "ml",
        "robot": {
            "name": "made",
            "sign": [1, -1],
            "limits": [[-3, 3], [-3, 3]],
            "nominal": AXES_OF,
            "calibrated": AXES_OF,
            "errors": AXES_OF,
        },
        "T_flange_scanner": FRAME,
        "stations": [{"id": "1", "artefact": "mbc", "T_base_station": FRAME, "std": [0.1] * 6}],
        "balls": [{"id": 1, "centre_mm": [1, 2, 3]}],
        "parameters": [{"name": "theta_1", "value": 0.1, "error": 0.0, "unit": "rad", "std": 0.001, "status": "free"}],
        "names": ["theta_1"],
        "covariance": [[1e-6]],
        "noise": {"scanner_mm": [0.01, 0.01, 0.02], "joint_rad": [1e-5, 1e-5]},
        "fit": {"poses": 3, "centres": 24, "rms_mm": 0.02, "chi2": 50.0, "dof": 52, "rank": 1},
        "verification": {"places": [{"station": "2", "balls": [1, 2], "certified_mm": 10.0, "before_mm": 0.3, "after_mm": 0.02}]},
    }
).encode()


def result_json(path: Path) -> object:
    """Read, and said in the words of a report."""
    return content_of(load_result(path))


def plan_text(data: bytes) -> object:
    return yaml_source.parse(data.decode("utf-8", "replace"), Path("plan.yaml"))


@cache
def targets() -> dict[str, Target]:
    seeds = gocator_seeds()
    cell = parse_cell(CELL.decode())
    _, poses = in_file(
        "poses.csv", lambda path: _read_poses(read_table(path, csv_columns.poses_schema(cell.robot.n, cell.ball_ids)), cell, "")
    )(POSES)
    words = struct.unpack(">2H", struct.pack(">f", 38.25))
    modbus_seeds = (
        struct.pack(">HHBBB2H", 0, 7, 1, 3, 4, *words),
        struct.pack(">HHBBBB", 0, 4, 1, 2, 1, 1),
        struct.pack(">HHBBB", 0, 3, 1, 0x83, 2),
    )
    listed = [
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
        Target("plan YAML", (PLAN,), plan_text),
        Target("cell YAML", (CELL,), lambda data: parse_cell(data.decode("utf-8", "replace"))),
        Target(
            "observation set, poses.csv",
            (POSES,),
            in_file(
                "poses.csv", lambda path: _read_poses(read_table(path, csv_columns.poses_schema(cell.robot.n, cell.ball_ids)), cell, "")
            ),
        ),
        Target(
            "observation set, centres.csv",
            (CENTRES,),
            in_file("centres.csv", lambda path: _read_centres(read_table(path, csv_columns.CENTRES), cell, poses)),
        ),
        Target("observation set, cell.yaml", (CELL,), in_file("cell.yaml", lambda path: read_observation_set(path.parent), SET)),
        Target("certificate CSV", (LISTED, LISTED_HERE), in_file("c.csv", lambda path: read_certificate(path, "mbc"))),
        Target("certificate YAML", (BALLS,), in_file("c.yaml", lambda path: read_certificate(path, "mbc"))),
        Target("certificate DMIS", (DMIS,), in_file("c.dmo", lambda path: read_certificate(path, "mbc"))),
        Target("cloud PLY", PLYS, in_file("c.ply", read_cloud)),
        Target("gopxl data set", gopxl_seeds(), gopxl_set),
        Target("gopxl reply", (gopxl_reply_seed(),), gopxl_reply),
        Target("journal", (JOURNAL,), in_file("journal.jsonl", lambda path: (read_lines(path), find_gaps(path.parent)))),
        Target("checksums", (CHECKSUMS,), in_file("checksums.jsonl", lambda path: read_stretches(path.parent))),
        Target(
            "plan kept in a run folder",
            (plan_files_text({"a.yaml": "a: 1", "b.yaml": "b: [2]"}, "real").encode(),),
            in_file("plan.files.json", lambda path: read_kept_plan(path.parent), {"plan.yaml": PLAN}),
        ),
        Target("result JSON", (RESULT,), in_file("result.json", result_json)),
    ]
    return {target.name: target for target in listed}
