"""XML files of other people: read within limits, and edited so that every byte that is not to change stays as it is."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers.expat import XMLParserType
from xml.sax.saxutils import quoteattr

from defusedxml import ElementTree as SafeTree
from defusedxml.common import DefusedXmlException

from mbcacq.errors import ConfigError

MAX_BYTES, MAX_DEPTH = 16 << 20, 200  # a tree of elements nested some thousand deep cannot even be discarded without running out of stack
_BYTE_ORDER_MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
_DECLARED = re.compile(rb"""^<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]+)""")
_TAG = re.compile(rb"""<[^\s/>]+(?:\s+[^\s=]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*/?>""")
_ATTRIBUTE = re.compile(r"""([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")


class XmlFile:
    """The elements of a file and where they stand in its text.

    root: the tree; edits do not change it. Raises ConfigError, naming the file, where it is not well-formed, too large, nested too deep,
    or declares a document type or entities.
    """

    def __init__(self, data: bytes, path: Path | str) -> None:
        try:
            self._read(data)
        except DefusedXmlException:
            raise ConfigError(f"{path}: declares a document type or entities, which are refused; expand it first") from None
        except ElementTree.ParseError as error:
            line, reason = error.position[0], str(error).split(": line")[0]
            raise ConfigError(f"{path}:{line}: is not well-formed XML: {reason}") from None
        except (ValueError, LookupError) as error:  # LookupError: unknown encoding
            raise ConfigError(f"{path}: cannot be read as XML: {error}") from None

    def _read(self, data: bytes) -> None:
        if len(data) > MAX_BYTES:
            raise ValueError(f"it has {len(data)} bytes, more than {MAX_BYTES}")
        declared = _DECLARED.match(data)
        plain = (b"", declared[1].decode() if declared else "utf-8")
        self._mark, self._encoding = next((each for each in _BYTE_ORDER_MARKS if data.startswith(each[0])), plain)
        text = data[len(self._mark) :].decode(self._encoding)
        self._bytes = text.encode()  # the parser tells places in bytes; it is given these, whatever the declaration says
        self._places = _Places()
        parser = SafeTree.DefusedXMLParser(target=self._places, encoding="utf-8", forbid_dtd=True)
        self._places.expat = parser.parser
        parser.feed(self._bytes)
        self.root: Element = parser.close()
        self._edits: list[tuple[int, int, str]] = []  # first and last byte, and what stands there instead
        self._line_end = "\r\n" if "\r\n" in text else "\n"

    def line(self, element: Element) -> int:
        """The line where an element begins, from 1."""
        return self._places.lines[element]

    def set_attributes(self, element: Element, **values: str) -> None:
        """Give an element's attributes new values, once; what it has not is put behind the others."""
        found = _TAG.match(self._bytes, self._places.begins[element])
        assert found is not None, "an element begins with a tag"
        new = found[0].decode()
        for name, value in values.items():
            known = next((a for a in _ATTRIBUTE.finditer(new) if a[1] == name), None)
            if known is not None:
                new = new[: known.start(2)] + quoteattr(value) + new[known.end(2) :]
            else:
                end = re.search(r"\s*/?>$", new)
                assert end is not None, "a tag ends"
                new = f"{new[: end.start()]} {name}={quoteattr(value)}{new[end.start() :]}"
        self._edits.append((*found.span(), new))

    def append(self, element: Element, text: str) -> None:
        """Put text, whose lines end with a line feed, behind the last child of an element that has an end tag."""
        end = self._places.ends[element]
        self._edits.append((end, end, text.replace("\n", self._line_end)))

    def comment(self, lines: Sequence[str]) -> None:
        """Put comments in front of the root element, a line each."""
        begin = self._places.begins[self.root]
        said = "".join(f"<!-- {line.replace('--', '- -')} -->{self._line_end}" for line in lines)
        self._edits.append((begin, begin, said))

    def edited(self) -> bytes:
        """The file with all edits, in its encoding."""
        data = self._bytes
        for first, last, text in sorted(self._edits, key=lambda edit: edit[0], reverse=True):
            data = data[:first] + text.encode() + data[last:]
        return self._mark + data.decode().encode(self._encoding)


class _Places(ElementTree.TreeBuilder):
    """Notes where the elements begin and where their end tags do, in bytes."""

    expat: XMLParserType

    def __init__(self) -> None:
        super().__init__()
        self.begins: dict[Element, int] = {}
        self.ends: dict[Element, int] = {}
        self.lines: dict[Element, int] = {}
        self._depth = 0

    def start(self, tag, attrs, /):
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ValueError(f"elements are nested more than {MAX_DEPTH} deep")
        element = super().start(tag, attrs)
        self.begins[element], self.lines[element] = self.expat.CurrentByteIndex, self.expat.CurrentLineNumber
        return element

    def end(self, tag, /):
        self._depth -= 1
        element = super().end(tag)
        self.ends[element] = self.expat.CurrentByteIndex
        return element
