"""One quantity in a Modbus device: where it sits, how it is coded, and what it means."""

from __future__ import annotations

import struct
from typing import Literal

from pydantic import Field

from mbcacq.devices import DriverOptions

Table = Literal["holding", "input", "coil", "discrete"]

_CODES = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}


class Register(DriverOptions):
    """value = raw * scale + offset. ``word_order`` big: the high word comes first. ``bit`` picks one bit of a 16-bit register. ``valid``:
    what a sensor may read; beyond it its probe is taken to be broken. ``max_rate``: how fast it can change, unit/s; a faster change is
    read again and then refused."""

    address: int = Field(ge=0, le=65535)
    table: Table = "holding"
    type: Literal["int16", "uint16", "int32", "uint32", "float32"] = "uint16"
    word_order: Literal["big", "little"] = "big"
    scale: float = Field(default=1.0, gt=0)
    offset: float = 0.0
    bit: int | None = Field(default=None, ge=0, le=15)
    unit: str = ""
    valid: tuple[float, float] | None = None
    max_rate: float | None = Field(default=None, gt=0)

    @property
    def is_bit(self) -> bool:
        return self.table in ("coil", "discrete")

    @property
    def count(self) -> int:
        """Registers (or bits) it occupies."""
        return 1 if self.is_bit else struct.calcsize(">" + _CODES[self.type]) // 2

    def encode(self, value: float) -> list[int]:
        """Registers for a value in its unit. Raises ValueError if it does not fit the type."""
        raw = (value - self.offset) / self.scale
        try:
            data = struct.pack(">" + _CODES[self.type], raw if self.type == "float32" else round(raw))
        except (struct.error, OverflowError) as error:
            raise ValueError(f"{value:g} {self.unit}".strip() + f" does not fit a {self.type} with scale {self.scale:g}") from error
        words = list(struct.unpack(f">{len(data) // 2}H", data))
        return words if self.word_order == "big" else words[::-1]

    def decode(self, words: list[int]) -> float:
        """Value in its unit from ``count`` registers, or from one bit."""
        if self.is_bit:
            return float(bool(words[0]))
        if self.bit is not None:
            return float(words[0] >> self.bit & 1)
        words = words[: self.count] if self.word_order == "big" else words[: self.count][::-1]
        (raw,) = struct.unpack(">" + _CODES[self.type], struct.pack(f">{len(words)}H", *words))
        return raw * self.scale + self.offset
