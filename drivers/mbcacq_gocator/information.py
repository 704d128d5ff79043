"""What the sensor says about itself: identity, state, loaded job."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

from mbcacq.devices import IdentityError, ProtocolError

READY, RUNNING, CONFLICT = 0, 1, -1
_RECORD = struct.Struct("<I4s32s4sii")
_V1_SIZE = 56
_STATE_NAMES = tuple(
    """
state login alignment_reference alignment_state recording playback_source uptime_s uptime_us playback_position playback_count autostart
accelerator voltage cable_length_mm quick_edit security branding
""".split()
)


@dataclass(frozen=True)
class SystemInfo:
    """Identity of the connected sensor. state: 0 ready, 1 running, -1 conflict. Names are empty before firmware 5.3."""

    serial: int
    part_number: str
    firmware: tuple[int, int, int, int]
    state: int
    model_number: str = ""
    display_name: str = ""

    @property
    def model(self) -> str:
        return self.model_number or self.display_name or _model_in(self.part_number) or self.part_number

    @property
    def firmware_text(self) -> str:
        return ".".join(map(str, self.firmware))

    def check_model(self, wanted: str) -> None:
        """Raises IdentityError unless ``wanted`` ('3210', 'Gocator 3210', a part number; '' for any) names this sensor."""
        names = {
            _plain(n)
            for n in (self.model_number, self.display_name, self.part_number, self.part_number.split("-")[0], _model_in(self.part_number))
            if n
        }
        if wanted.strip() and _plain(wanted) not in names:
            raise IdentityError(
                f"the plan asks for Gocator {wanted} but the sensor is a {self.model} "
                f"(part number {self.part_number}, serial {self.serial}); correct the model or the address"
            )


def parse_info_1(payload: memoryview) -> SystemInfo:
    """Reply of command 0x4002: one 56-byte record, then those of buddies."""
    return _record(payload[:_V1_SIZE], _V1_SIZE)


def parse_info_2(payload: memoryview) -> SystemInfo:
    """Reply of command 0x4010: u16 size of the local record, the record; what follows concerns other sensors."""
    if len(payload) < 2:
        raise ProtocolError("the Gocator's system info is empty")
    (size,) = struct.unpack_from("<H", payload)
    return _record(payload[2 : 2 + size], size)


def parse_states(payload: memoryview) -> dict[str, int]:
    """Reply of command 0x4525 by name; older firmware sends fewer, newer may send more."""
    if len(payload) < 4:
        raise ProtocolError("the Gocator's list of states is empty")
    (count,) = struct.unpack_from("<I", payload)
    if 4 + 4 * count > len(payload):
        raise ProtocolError(f"the Gocator announces {count} states but sends {(len(payload) - 4) // 4}")
    known = min(count, len(_STATE_NAMES))
    return dict(zip(_STATE_NAMES, struct.unpack_from(f"<{known}i", payload, 4), strict=False))


def text(field: bytes | memoryview) -> str:
    """A NUL-padded string field."""
    return bytes(field).split(b"\0", 1)[0].decode("utf-8", "replace")


def _record(record: memoryview, announced: int) -> SystemInfo:
    if len(record) < _RECORD.size or len(record) < announced:
        raise ProtocolError(f"the Gocator's system info has {len(record)} bytes, at least {max(_RECORD.size, announced)} were announced")
    serial, _, part, firmware, state, _ = _RECORD.unpack_from(record)
    at, model, display = _RECORD.size, "", ""
    if announced >= at + 64:
        model, display = text(record[at : at + 32]), text(record[at + 32 : at + 64])
    elif announced >= at + 32:
        display = text(record[at : at + 32])
    return SystemInfo(serial, text(part), tuple(firmware), state, model, display)


def _model_in(part_number: str) -> str:
    """'313504A-2-R-01-T' is a 3504: two digits of the product line, then the model."""
    match = re.match(r"\d{2}(\d{4})", part_number)
    return match.group(1) if match else ""


def _plain(name: str) -> str:
    return re.sub(r"^(lmi|gocator|\s|-)+", "", name.strip().lower())
