"""EKI's XML, as the controller reads it (any junk between telegrams, FRAME values as attributes) and writes it (open and close tags)."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any
from xml.etree.ElementTree import Element, ParseError
from xml.sax.saxutils import quoteattr

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from mbcacq_fakes.protocols.krc.krl.values import Struct

_POSE = ("X", "Y", "Z", "A", "B", "C")
_PLACEHOLDER = re.compile(r"\$\$(\w+):\w+\$\$")


class Intake:
    """Bytes in, telegrams out; each ends with the closing tag of the root. ``too_much`` tells that BUFFSIZE is exceeded."""

    def __init__(self, root: str, limit: int) -> None:
        name = re.escape(root.encode())
        self._telegram = re.compile(rb"<" + name + rb"(?=[\s/>])(?:[^>]*/>|.*?</" + name + rb"\s*>)", re.S)
        self._begin = re.compile(rb"<" + name + rb"(?=[\s/>])")
        self._limit, self._buffer, self._longest = limit, b"", len(root) + 1
        self.too_much = False

    def feed(self, data: bytes) -> list[Element]:
        self._buffer += data
        found = []
        while (match := self._telegram.search(self._buffer)) is not None:
            self._buffer = self._buffer[match.end() :]
            try:
                found.append(fromstring(match[0], forbid_dtd=True))
            except (ParseError, DefusedXmlException, ValueError):
                continue  # EKI logs an error and goes on
        if self._begin.search(self._buffer) is None:
            self._buffer = self._buffer[-self._longest :]
        self.too_much = len(self._buffer) > self._limit
        return found


def pick(telegram: Element, path: str, kind: str) -> Any:
    """The value at a path (``a/b/@X``: attribute X of a/b) as KRL gets it; None if it is not there or not of its type."""
    steps = path.split("/")[1:]
    attribute = steps.pop()[1:] if steps and steps[-1].startswith("@") else None
    element = telegram.find("/".join(steps)) if steps else telegram
    if element is None:
        return None
    text = element.get(attribute) if attribute else element.text
    try:
        if kind == "FRAME":
            return Struct(**{a.lower(): float(element.attrib[a]) for a in _POSE})
        return None if text is None else _READ[kind](text)
    except (KeyError, ValueError):
        return None


_READ: dict[str, Callable[[str], Any]] = {
    "INT": int,
    "REAL": float,
    "BOOL": lambda text: {"0": False, "1": True}[text.strip()],
    "STRING": str,
}


def subtree(paths: Iterable[str], values: Mapping[str, Any], wanted: str) -> str:
    """The elements below ``wanted`` that have a value, in the order of the configuration, inside their root."""
    tree: dict[str, Any] = {}
    for path in paths:
        if path not in values or not (path + "/").startswith(wanted + "/"):
            continue
        steps, node = path.split("/"), tree
        for step in steps[:-1]:
            node = node.setdefault(step, {})
        value = values[path]
        if isinstance(value, Struct):
            node.setdefault(steps[-1], {}).update({"@" + a: number(getattr(value, a.lower())) for a in sorted(_POSE)})
        elif steps[-1].startswith("@"):
            node[steps[-1]] = value
        else:
            node.setdefault(steps[-1], {})[""] = value
    return "".join(_write(name, node) for name, node in tree.items())


def fill(template: str, values: Mapping[str, Any]) -> str:
    """A whole EKI 6 template; what was never set is 0 or empty."""
    return _PLACEHOLDER.sub(lambda m: str(values.get(m[1], "" if ":String" in m[0] else "0")), template)


def number(value: float) -> str:
    return f"{value:.6f}"


def _write(name: str, node: Mapping[str, Any]) -> str:
    attributes = "".join(f" {key[1:]}={quoteattr(str(value))}" for key, value in node.items() if key.startswith("@"))
    inner = "".join(_write(key, value) for key, value in node.items() if key and not key.startswith("@"))
    return f"<{name}{attributes}>{node.get('', '')}{inner}</{name}>"
