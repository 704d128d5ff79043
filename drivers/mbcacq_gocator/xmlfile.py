"""The sensor's XML files, read within limits of size, depth and number of parts."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from mbcacq.devices import ProtocolError, parse_xml

MAX_SIZE = 4 * 2**20  # a live configuration has some 10 kB, more with tools


def parse(data: bytes, what: str, root: str) -> Element:
    """The root element, which must be called ``root``. Raises ProtocolError naming the file as ``what``."""
    if len(data) > MAX_SIZE:
        raise ProtocolError(f"the sensor's {what} has {len(data)} bytes, more than {MAX_SIZE}")
    try:
        return parse_xml(data, root)
    except ValueError as error:
        raise ProtocolError(f"the sensor's {what} {error}") from None
