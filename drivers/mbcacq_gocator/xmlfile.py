"""The sensor's XML files, read within limits of size, depth and number of parts.

A tree of elements nested some thousand deep cannot be copied, written or even discarded without running out of stack.
"""

from __future__ import annotations

from xml.etree import ElementTree

from defusedxml import ElementTree as SafeTree
from defusedxml.common import DefusedXmlException

from mbcacq.devices import ProtocolError

MAX_SIZE, MAX_DEPTH, MAX_PARTS = 4 * 2**20, 64, 100_000  # a live configuration has some 10 kB and 200 elements 6 deep, more with tools


class _BoundedXml(ElementTree.TreeBuilder):
    """Raises ProtocolError if elements are nested too deep, or elements and attributes are too many."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._parts = 0

    def start(self, tag, attrs, /):
        self._depth += 1
        self._parts += 1 + len(attrs)
        if self._depth > MAX_DEPTH:
            raise ProtocolError(f"elements are nested more than {MAX_DEPTH} deep")
        if self._parts > MAX_PARTS:
            raise ProtocolError(f"there are more than {MAX_PARTS} elements and attributes")
        return super().start(tag, attrs)

    def end(self, tag, /):
        self._depth -= 1
        return super().end(tag)


def parse(data: bytes, what: str, root: str) -> ElementTree.Element:
    """The root element, which must be called ``root``. Raises ProtocolError naming the file as ``what``."""
    if len(data) > MAX_SIZE:
        raise ProtocolError(f"the sensor's {what} has {len(data)} bytes, more than {MAX_SIZE}")
    parser = SafeTree.DefusedXMLParser(target=_BoundedXml(), forbid_dtd=True)
    try:
        parser.feed(data)
        found = parser.close()
    except (ElementTree.ParseError, DefusedXmlException, ProtocolError, ValueError, LookupError) as error:  # LookupError: unknown encoding
        raise ProtocolError(f"the sensor's {what} cannot be read as XML: {error}") from None
    if found.tag != root:
        raise ProtocolError(f"the sensor's {what} starts with <{found.tag}> instead of <{root}>")
    return found
