"""The telegrams as the controller writes and reads them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

_AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
_EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
_POSE = ("X", "Y", "Z", "A", "B", "C")
_ATTRIBUTES = {
    "RIst": _POSE,
    "RSol": _POSE,
    "AIPos": _AXES,
    "ASPos": _AXES,
    "EIPos": _EXTERNAL,
    "ESPos": _EXTERNAL,
    "MACur": _AXES,
    "MECur": _EXTERNAL,
    "GearTorque": _AXES,
    "AJPos": _AXES,
    "Tech": tuple(f"C2{k}" for k in range(1, 11)),
}
_MAX_ANSWER = 16384
_SPACING = (("", "/>", "="), ("\r\n", " />", "="), ("\n", "/>", "="), ("  ", "  />", " = "))  # between elements, end of one, around =


class RobTemplate:
    """Formats ``<Rob>``: values of each element in the order given, Delay and outputs as integers, IPOC last."""

    def __init__(
        self,
        elements: Sequence[str],
        precision: int,
        spaced: int = 0,
        upper_type: bool = False,
        swap: bool = False,
        outputs: Sequence[int] = (),
    ) -> None:
        self.elements = tuple(e for e in elements if e != "IPOC") + (("Digout",) if outputs else ())
        number, (gap, end, equals) = f"%.{precision}f", _SPACING[spaced]
        parts = []
        for element in self.elements:
            if element == "Delay":
                parts.append(f'<Delay D{equals}"%d"{end}')
            elif element == "Digout":
                parts.append("<Digout " + " ".join(f'o{n}{equals}"%d"' for n in outputs) + end)
            else:
                parts.append(f"<{element} " + " ".join(f'{a}{equals}"{number}"' for a in _ATTRIBUTES[element]) + end)
        if swap:
            self.elements = self.elements[::-1]
            parts.reverse()
        self._body = f'<Rob {"TYPE" if upper_type else "Type"}="KUKA">{gap}' + "".join(p + gap for p in parts) + "<IPOC>"
        self._tail = f"</IPOC>{gap}</Rob>"

    def body(self, values: Sequence[float]) -> str:
        """Everything before the IPOC."""
        return self._body % tuple(values)

    def finish(self, body: str, ipoc: int) -> bytes:
        return f"{body}{ipoc}{self._tail}".encode()


@dataclass(frozen=True)
class RsiAnswer:
    ipoc: str
    sen_type: str
    correction: dict[str, float]
    stop: bool
    outputs: dict[int, bool] = field(default_factory=dict)  # those that it names


class SenReader:
    """Reads ``<Sen>``: any order, any spacing. None for what is not well-formed."""

    def __init__(self, correction: str, stop_element: str) -> None:
        self._root = re.compile(rb"\s*<Sen\s+Type\s*=\s*[\"']([^\"'<>&]{0,80})[\"']\s*>(.*)</Sen\s*>[\s\0]*", re.S)
        self._ipoc = re.compile(rb"<IPOC\s*>\s*(-?\d{1,20})\s*</IPOC\s*>")
        self._correction = re.compile(rb"<" + correction.encode() + rb"\s([^<>]*?)/?>")
        self._axis = re.compile(rb"(\w+)\s*=\s*[\"']([^\"']*)[\"']")
        self._switch, self._output = re.compile(rb"<DiO\s([^<>]*?)/?>"), re.compile(rb"\bo(\d{1,4})\s*=\s*[\"']([01])[\"']")
        self._stop = re.compile(b"<" + stop_element.encode() + rb"\s*>\s*(\d+)\s*</") if stop_element else None

    def read(self, data: bytes) -> RsiAnswer | None:
        root = self._root.fullmatch(data) if len(data) <= _MAX_ANSWER and b"<!" not in data else None
        ipoc = self._ipoc.search(root[2]) if root else None
        if root is None or ipoc is None:
            return None
        found = self._correction.search(root[2])
        try:
            correction = {name.decode(): float(value) for name, value in self._axis.findall(found[1])} if found else {}
        except ValueError:
            return None
        stop = self._stop.search(root[2]) if self._stop else None
        switch = self._switch.search(root[2])
        outputs = {int(number): value == b"1" for number, value in self._output.findall(switch[1])} if switch else {}
        return RsiAnswer(ipoc[1].decode(), root[1].decode(), correction, stop is not None and int(stop[1]) != 0, outputs)
