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
_NAMESPACE = re.compile(rb"""\sxmlns:([\w.-]+)\s*=""")
_PREFIXED = re.compile(rb"""(?:(?<=<)|(?<=</)|(?<=\s))([\w.-]+):(?=[\w.-]+(?:\s*=\s*["']|[\s/>]))""")
_ATTRIBUTE = re.compile(r"""([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")


class XmlFile:
    """The elements of a file and where they stand in its text.

    root: the tree, without a default namespace; edits do not change it. White space before the XML declaration, a document type that
    declares nothing, and prefixes whose namespace is not declared are read over, as most readers of robot descriptions do. Raises
    ConfigError, naming the file, where it is not well-formed, too large, nested too deep, or declares entities.
    """

    def __init__(self, data: bytes, path: Path | str) -> None:
        self._line_shift = 0
        try:
            self._read(data)
        except DefusedXmlException:
            raise ConfigError(f"{path}: declares entities, which are refused; expand it first") from None
        except ElementTree.ParseError as error:
            line, reason = error.position[0] + self._line_shift, str(error).split(": line")[0]
            raise ConfigError(f"{path}:{line}: is not well-formed XML: {reason}") from None
        except (ValueError, LookupError) as error:  # LookupError: unknown encoding
            raise ConfigError(f"{path}: cannot be read as XML: {error}") from None

    def _read(self, data: bytes) -> None:
        if len(data) > MAX_BYTES:
            raise ValueError(f"it has {len(data)} bytes, more than {MAX_BYTES}")
        declared = _DECLARED.match(data.lstrip())
        plain = (b"", declared[1].decode() if declared else "utf-8")
        self._mark, self._encoding = next((each for each in _BYTE_ORDER_MARKS if data.startswith(each[0])), plain)
        text = data[len(self._mark) :].decode(self._encoding)
        begin = len(text) - len(text.lstrip())
        self._before, text = text[:begin], text[begin:]
        self._line_shift = self._before.count("\n")
        self._bytes = text.encode()  # the parser tells places in bytes; it is given these, whatever the declaration says
        self._places = _Places()
        self.root: Element = self._parsed(_without_unknown_prefixes(self._bytes))
        self._edits: list[tuple[int, int, str]] = []  # first and last byte, and what stands there instead
        self._line_end = "\r\n" if "\r\n" in text else "\n"

    def _parsed(self, data: bytes) -> Element:
        # The type of a document is read over; its entities, and files it would fetch, are refused.
        parser = SafeTree.DefusedXMLParser(target=self._places, encoding="utf-8", forbid_dtd=False, forbid_entities=True)
        self._places.expat = parser.parser
        parser.feed(data)
        return parser.close()

    def line(self, element: Element) -> int:
        """The line where an element begins, from 1."""
        return self._places.lines[element] + self._line_shift

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
        return self._mark + (self._before + data.decode()).encode(self._encoding)


def _without_unknown_prefixes(data: bytes) -> bytes:
    """The same bytes in number, with an underscore for the colon behind each prefix that no xmlns declares, so that expat reads on."""
    declared = {match[1] for match in _NAMESPACE.finditer(data)} | {b"xml", b"xmlns"}
    if {match[1] for match in _PREFIXED.finditer(data)} <= declared:
        return data
    return _PREFIXED.sub(lambda match: match[0] if match[1] in declared else match[1] + b"_", data)


class _Places(ElementTree.TreeBuilder):
    """Notes where the elements begin and where their end tags do, in bytes."""

    expat: XMLParserType

    def __init__(self) -> None:
        super().__init__()
        self.begins: dict[Element, int] = {}
        self.ends: dict[Element, int] = {}
        self.lines: dict[Element, int] = {}
        self._depth = 0
        self._default = set[str]()

    def start_ns(self, prefix, uri):
        if not prefix:
            self._default.add(f"{{{uri}}}")

    def start(self, tag, attrs, /):
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ValueError(f"elements are nested more than {MAX_DEPTH} deep")
        space, brace, name = tag.rpartition("}")
        element = super().start(name if brace and space + brace in self._default else tag, attrs)
        self.begins[element], self.lines[element] = self.expat.CurrentByteIndex, self.expat.CurrentLineNumber
        return element

    def end(self, tag, /):
        self._depth -= 1
        space, brace, name = tag.rpartition("}")
        element = super().end(name if brace and space + brace in self._default else tag)
        self.ends[element] = self.expat.CurrentByteIndex
        return element
