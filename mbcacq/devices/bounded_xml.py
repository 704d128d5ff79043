"""XML from a device, read within limits of depth and number of parts.

A tree of elements nested some thousand deep cannot be copied, written or even discarded without running out of stack.
"""

from __future__ import annotations

from xml.etree import ElementTree

from defusedxml import ElementTree as SafeTree

MAX_DEPTH, MAX_PARTS = 64, 100_000  # a sensor's live configuration has some 200 elements 6 deep, more with tools


class _BoundedXml(ElementTree.TreeBuilder):
    """Raises ValueError if elements are nested too deep, or elements and attributes are too many."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._parts = 0

    def start(self, tag, attrs, /):
        self._depth += 1
        self._parts += 1 + len(attrs)
        if self._depth > MAX_DEPTH:
            raise ValueError(f"elements are nested more than {MAX_DEPTH} deep")
        if self._parts > MAX_PARTS:
            raise ValueError(f"there are more than {MAX_PARTS} elements and attributes")
        return super().start(tag, attrs)

    def end(self, tag, /):
        self._depth -= 1
        return super().end(tag)


def parse_xml(data: bytes, root: str) -> ElementTree.Element:
    """The root element, which must be called ``root``. Raises ValueError with what is wrong, to be read after what the data are."""
    parser = SafeTree.DefusedXMLParser(target=_BoundedXml(), forbid_dtd=True)
    try:
        parser.feed(data)
        found = parser.close()
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # ValueError: also what is forbidden; LookupError: unknown encoding
        raise ValueError(f"cannot be read as XML: {error}") from None
    if found.tag != root:
        raise ValueError(f"starts with <{found.tag}> instead of <{root}>")
    return found
