"""What the fake answers to every command of the control channel: payload in, payload out.

A handler gets the sensor's state and the request's payload and returns the reply's payload, or raises ``CommandRefused``. Commands that
only need an OK stand in ``ACCEPTED``. Anything else is answered with "command not recognised" by the channel, because an
unanswered command would leave a client waiting for that reply for ever.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable

from mbcacq_fakes.protocols.gocator import actions
from mbcacq_fakes.protocols.gocator.files import CAPACITY
from mbcacq_fakes.protocols.gocator.replies import BAD_PARAMETER, CommandRefused
from mbcacq_fakes.protocols.gocator.state import SensorState

Handler = Callable[[SensorState, bytes], bytes]

# No reply payload and no effect that a client could see: change password, buddies, replay, seek, step, statistics, outputs, log, date and
# time, address, factory restore, ping, settings of recording, playback, autostart, quick edit...
# fmt: off
ACCEPTED = frozenset({
    0x4004, 0x4005, 0x4011, 0x4012, 0x4013, 0x101E, 0x3013, 0x100E, 0x4301, 0x1014,
    0x4513, 0x4503, 0x4501, 0x4526, 0x4518, 0x4519, 0x4538, 0x460A, 0x4610, 0x101D, 0x4103, 0x4516, 0x4523, 0x452B, 0x4540,
})
# fmt: on


def name_at(payload: bytes, at: int = 0, size: int = 64) -> str:
    if len(payload) < at + size:
        raise CommandRefused(BAD_PARAMETER)
    return payload[at : at + size].split(b"\0", 1)[0].decode("utf-8", "replace")


def block(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def name_list(names: list[str]) -> bytes:
    return struct.pack("<I", len(names)) + b"".join(struct.pack("64s", n.encode()) for n in names)


def _record(state: SensorState, names: bool) -> bytes:
    fixed = struct.pack(
        "<I4s32s4sii",
        state.serial,
        socket.inet_aton(state.address),
        state.part_number.encode(),
        bytes(state.firmware),
        1 if state.running else 0,
        0,
    )
    return fixed + struct.pack("32s32s", state.model.encode(), state.model.encode()) if names else fixed


def _system_info_1(state: SensorState, payload: bytes) -> bytes:
    return _record(state, names=False) + struct.pack("<ii", 0, 0)


def _system_info_2(state: SensorState, payload: bytes) -> bytes:
    record = _record(state, names=True)
    return struct.pack("<H", len(record)) + record + struct.pack("<IHIH", 0, 60, 0, 8)


def _states(state: SensorState, payload: bytes) -> bytes:
    seconds, microseconds = divmod(int(state.uptime_s * 1e6), 1_000_000)
    setting = state.settings
    items = [
        1 if state.running else 0,
        setting["login"],
        0,
        setting["alignment_state"],
        0,
        0,
        seconds,
        microseconds,
        *[0] * 7,
        1 if state.options.password else 0,
        0,
    ]
    items = items[:11] if state.generation < 5 else items
    return struct.pack(f"<I{len(items)}i", len(items), *items)


def _write_file(state: SensorState, payload: bytes) -> bytes:
    (size,) = struct.unpack_from("<I", payload, 64)
    if len(payload) < 68 + size:
        raise CommandRefused(BAD_PARAMETER)
    state.files.write(name_at(payload), payload[68 : 68 + size])
    return b""


def _copy_file(state: SensorState, payload: bytes) -> bytes:
    state.files.copy(name_at(payload), name_at(payload, 64))
    return b""


def _delete_file(state: SensorState, payload: bytes) -> bytes:
    state.files.delete(name_at(payload))
    return b""


def _set_default_job(state: SensorState, payload: bytes) -> bytes:
    state.files.set_default(name_at(payload))
    return b""


def _log_in(state: SensorState, payload: bytes) -> bytes:
    (user,) = struct.unpack_from("<i", payload)
    actions.log_in(state, user, name_at(payload, 4))
    return b""


def _action(act: Callable[[SensorState], None]) -> Handler:
    """An action that takes no payload and gives none."""

    def handle(state: SensorState, payload: bytes) -> bytes:
        act(state)
        return b""

    return handle


HANDLERS: dict[int, Handler] = {
    0x4511: lambda s, p: bytes(s.faults.get("protocol_version") or s.protocol),
    0x4002: _system_info_1,
    0x4010: _system_info_2,
    0x4525: _states,
    0x3012: lambda s, p: struct.pack("<B4s4s4s", 0, socket.inet_aton(s.address), b"\xff\xff\xff\x00", bytes(4)),
    0x101A: lambda s, p: name_list(s.files.names(name_at(p))),
    0x4605: lambda s, p: name_list(s.files.names(name_at(p))),
    0x1007: lambda s, p: block(s.files.read(name_at(p))),
    0x1006: _write_file,
    0x101B: _copy_file,
    0x1008: _delete_file,
    0x1021: lambda s, p: struct.pack("<Q", s.files.used()),
    0x1022: lambda s, p: struct.pack("<Q", CAPACITY - s.files.used()),
    0x4100: lambda s, p: struct.pack("64s", s.files.default_job.encode()),
    0x4101: _set_default_job,
    0x4512: lambda s, p: struct.pack("<64sB", s.files.loaded_job.encode(), s.files.modified),
    0x100D: _action(actions.start),
    0x100F: _action(actions.start),
    0x1001: _action(actions.stop),
    0x4528: _action(actions.snapshot),
    0x4510: _action(actions.trigger),
    0x4102: _action(actions.clear_alignment),
    0x4003: _log_in,
    0x1005: lambda s, p: struct.pack("<i", int(s.files.number("Setup/ScanMode"))),
    0x100A: lambda s, p: struct.pack("<Q", s.ticks()),
    0x101C: lambda s, p: struct.pack("<q", s.encoder),
    0x1013: lambda s, p: block(s.files.read("_live.cfg")),
    0x4600: lambda s, p: struct.pack("<i", actions.align(s)),
    0x4522: lambda s, p: b"\0",
    0x4502: lambda s, p: struct.pack("<II", 0, 0),
    0x4539: lambda s, p: struct.pack("<HI", 0, 0),
    **{number: lambda s, p: b"" for number in ACCEPTED},
}

# Answered before a log-in where security is on: probe, version, identity, states, log-in.
WITHOUT_LOGIN = frozenset({0, 0x1100, 0x4511, 0x4002, 0x4010, 0x4525, 0x4003})

# Answered by a total and progress, then pushed in pieces as replies numbered 0x5000.
STREAMED: dict[int, Handler] = {0x4529: lambda s, p: s.files.read(name_at(p)), 0x4507: lambda s, p: b"", 0x4508: lambda s, p: b""}
