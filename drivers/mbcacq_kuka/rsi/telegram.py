"""The two RSI telegrams: ``<Rob>`` (controller to us) parsed by name, ``<Sen>`` (our answer) composed.

Hand-written, because GPIO attributes (``<GPIO 01="1"/>``) are no legal XML names, and because a 4 ms deadline is no place for a
general parser. Nothing is accepted that an RSI controller does not send: no DTD, no nesting, bounded sizes. Only IPOC and AIPos have to be
numbers in every telegram; whatever else is sent, strings too, may change its kind at any time.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, nan

MAX_VALUES = 192
MAX_DATAGRAM = 65535
SWITCH_ELEMENT, REPORT_ELEMENT = "DiO", "Digout"  # of the digital outputs, to the controller and from it: named as in KUKA's example

_NAME = rb"[\w.:\-]{1,64}"
_ATTRIBUTE = re.compile(rb"\s+(" + _NAME + rb")\s*=\s*(?:\"([^\"<]*)\"|'([^'<]*)')")
_ROOT = re.compile(rb"\s*(?:<\?xml[^<>&]{0,200}\?>\s*)?<Rob(?=[\s>])")
_CHILD = re.compile(rb"\s*<([A-Za-z_][\w.\-]{0,63})(?=[\s/>])")
_CLOSE = re.compile(rb"\s*(/?)>")
_TEXT = re.compile(rb"([^<]*)</(" + _NAME + rb")\s*>")  # blanks around the text are taken off later: one pass, however many there are
_END = re.compile(rb"\s*</Rob\s*>[\s\0]*")
_NUMBER = re.compile(rb"[-+]?(?:\d{1,20}\.?\d{0,32}|\.\d{1,32})(?:[eE][-+]?\d{1,3})?")
_NO_NUMBER = re.compile(rb"[-+]?(?:nan(?:\(\w*\))?|inf(?:inity)?|1\.#[a-z]{1,8}\d{0,8})", re.IGNORECASE)  # of several systems' printf
_IPOC = re.compile(rb"-?\d{1,20}")  # signed where a controller prints its 32 bits so
_NEEDED_GROUP = rb"([-+.\deE]{1,48})"
_NUMBER_GROUP = rb"([-+.\dA-Za-z#]{0,48})"
_TEXT_GROUP = rb"[^\"'<]*"
_MAX_NUMBER = 64


def output_attribute(number: int) -> str:
    """The attribute of both elements that stands for $OUT[number]: no name in XML begins with a digit."""
    return f"o{number}"


class Malformed(ValueError):
    """A datagram that is no ``<Rob>`` telegram."""


@dataclass(frozen=True)
class Value:
    """One value of a telegram: ``name`` is 'AIPos.A1' for an attribute, 'IPOC' for element text; data[start:end] is its text; ``numeric``:
    it is a number, or says that it is none ('nan')."""

    name: str
    start: int
    end: int
    numeric: bool


def scan(data: bytes) -> list[Value]:
    """All values of a ``<Rob>`` telegram in wire order, in any order, spacing and notation. Raises Malformed."""
    root = _ROOT.match(data)
    if root is None:
        raise Malformed("it does not begin with <Rob")
    values: list[Value] = []
    position = root.end()
    while attribute := _ATTRIBUTE.match(data, position):  # Type or TYPE: of no use to us
        position = attribute.end()
    position = _close(data, position, b"Rob", allow_empty=False)
    while not (end := _END.match(data, position)):
        child = _CHILD.match(data, position)
        if child is None:
            raise Malformed(f"unexpected text at byte {position}")
        position = _element(data, child, values)
        if len(values) > MAX_VALUES:
            raise Malformed(f"more than {MAX_VALUES} values")
    if end.end() != len(data):
        raise Malformed(f"bytes after </Rob> at byte {end.end()}")
    if len({v.name for v in values}) != len(values):
        raise Malformed("a value appears twice")
    return values


def _element(data: bytes, child: re.Match[bytes], values: list[Value]) -> int:
    tag, position, first = child[1], child.end(), len(values)
    while attribute := _ATTRIBUTE.match(data, position):
        start, stop = attribute.span(2) if attribute[2] is not None else attribute.span(3)
        values.append(_value(data, f"{tag.decode()}.{attribute[1].decode()}", start, stop))
        position = attribute.end()
    close = _CLOSE.match(data, position)
    if close is None:
        raise Malformed(f"<{tag.decode()}> is not closed at byte {position}")
    if close[1]:
        return close.end()
    text = _TEXT.match(data, close.end())
    if text is None or text[2] != tag:
        raise Malformed(f"</{tag.decode()}> is missing at byte {close.end()}")
    if text[1].strip() or len(values) == first:
        values.append(_value(data, tag.decode(), *text.span(1)))
    return text.end()


def _value(data: bytes, name: str, start: int, end: int) -> Value:
    while start < end and data[start] in b" \t\r\n":
        start += 1
    while end > start and data[end - 1] in b" \t\r\n":
        end -= 1
    number = _NUMBER.fullmatch(data, start, end) is not None
    if _needed(name):
        if end - start > _MAX_NUMBER or b"&" in data[start:end]:
            raise Malformed(f"{name} is no number")
        return Value(name, start, end, number)
    return Value(name, start, end, number or _NO_NUMBER.fullmatch(data, start, end) is not None)


def _needed(name: str) -> bool:
    """Whether no telegram is of use without this number."""
    return name == "IPOC" or name.startswith("AIPos.")


def _close(data: bytes, position: int, tag: bytes, allow_empty: bool) -> int:
    close = _CLOSE.match(data, position)
    if close is None or (close[1] and not allow_empty):
        raise Malformed(f"<{tag.decode()}> is not opened properly at byte {position}")
    return close.end()


class Parser:
    """Numbers of consecutive telegrams of one session, always in the order of ``names``.

    The layout of the first telegram becomes one regular expression, so that all later ones cost a single match; a telegram
    laid out otherwise (order, spacing) takes the slower way to the same numbers.
    """

    def __init__(self, first: bytes) -> None:
        """``first``: a telegram that shows what the session sends. Raises Malformed."""
        values = scan(first)
        numeric = [v for v in values if v.numeric]
        self.names = tuple(v.name for v in numeric)
        self._slot = {name: i for i, name in enumerate(self.names)}
        if not any(v.name == "IPOC" and _IPOC.fullmatch(first, v.start, v.end) for v in numeric):
            raise Malformed("IPOC is missing")
        self._ipoc = self._slot["IPOC"]
        pattern, position = [], 0
        for value in values:
            group = (_NEEDED_GROUP if _needed(value.name) else _NUMBER_GROUP) if value.numeric else _TEXT_GROUP
            pattern += [re.escape(first[position : value.start]), group]
            position = value.end
        self._match = re.compile(b"".join(pattern) + re.escape(first[position:])).fullmatch

    def parse(self, data: bytes) -> tuple[bytes, list[float]]:
        """IPOC as its digits, and all numbers by ``names`` (NaN where missing, or no number). Raises Malformed."""
        match = self._match(data)
        if match is not None and _IPOC.fullmatch((groups := match.groups())[self._ipoc]):
            try:
                return groups[self._ipoc], list(map(float, groups))
            except ValueError:
                pass
        return self._parse_slowly(data)

    def _parse_slowly(self, data: bytes) -> tuple[bytes, list[float]]:
        row, ipoc = [nan] * len(self.names), b""
        for value in scan(data):
            slot, text = self._slot.get(value.name), data[value.start : value.end]
            if not value.numeric and slot is not None and _needed(value.name):
                raise Malformed(f"{value.name} is no number")
            if slot is not None and _NUMBER.fullmatch(text):
                row[slot] = float(text)
            if value.name == "IPOC":
                ipoc = text
        if not _IPOC.fullmatch(ipoc):
            raise Malformed("IPOC is missing")
        return ipoc, row

    def slots(self, element: str, attributes: Sequence[str]) -> list[int] | None:
        """Where the named attributes of an element are in a row; None if the session does not send all of them."""
        names = [f"{element}.{a}" for a in attributes]
        return [self._slot[n] for n in names] if all(n in self._slot for n in names) else None


def decimals(data: bytes, element: str) -> int:
    """With how many decimals a telegram writes the attributes of ``element`` at most; 0 where it has none. Raises Malformed."""
    texts = [data[v.start : v.end] for v in scan(data) if v.numeric and v.name.startswith(f"{element}.")]
    return max((len(re.split(rb"[eE]", text.partition(b".")[2])[0]) for text in texts), default=0)


def finite(values: Sequence[float]) -> bool:
    """True if all are numbers an axis can have (deg)."""
    return all(isfinite(v) and abs(v) < 1e5 for v in values)


class Composer:
    """``<Sen>`` telegrams: ``compose(correction (6,) deg, IPOC digits)``. ``stop_element`` '' leaves that element out, and no ``outputs``
    (numbers of $OUT) the one that switches them. Without a correction (None) the controller keeps the one that it has (HOLDON="1")."""

    def __init__(self, sen_type: str, correction: str, stop_element: str, outputs: Sequence[int] = ()) -> None:
        for name in (sen_type, correction, stop_element or "Stop"):
            if not re.fullmatch(r"[A-Za-z_][\w.\-]{0,63}", name):
                raise ValueError(f"'{name}' is no name for an element or a type")
        axes = " ".join(f'A{i}="%.6f"' for i in range(1, 7))
        stop = f"<{stop_element}>%d</{stop_element}>" if stop_element else ""
        self._with_stop, self._bits = bool(stop), range(len(outputs))
        switched = " ".join(f'{output_attribute(number)}="%d"' for number in outputs)
        switch = f"<{SWITCH_ELEMENT} {switched}/>" if outputs else ""
        self._head, self._hold = (
            f'<Sen Type="{sen_type}">{stop}{moves}{switch}<IPOC>'.encode() for moves in (f"<{correction} {axes}/>", "")
        )
        self._last: tuple[object, bytes] = (None, b"")

    def compose(self, degrees: Sequence[float] | None, ipoc: bytes, stop: bool = False, outputs: int = 0) -> bytes:
        """IPOC goes back digit for digit: a controller silently discards anything else. outputs: bit k is the output given as the k-th."""
        key = (degrees, stop, outputs)
        if self._last[0] != key:
            values = (*([stop] if self._with_stop else []), *(degrees or ()), *[outputs >> k & 1 for k in self._bits])
            self._last = (key, (self._hold if degrees is None else self._head) % values)
        return self._last[1] + ipoc + b"</IPOC></Sen>"
