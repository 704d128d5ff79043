"""Which arrays of a data set are the scan: a job may also send what its tools made of it, and what other sensors saw.

Since firmware 5 every array says from which step of the processing it comes; before, only the scanner itself made surfaces.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from mbcacq.devices import ConfigError
from mbcacq_gocator.decode import ArrayMessage
from mbcacq_gocator.layouts import SURFACE_INTENSITY, SURFACE_POINTS, TYPE_NAMES, UNIFORM_SURFACE

TOOL_OUTPUT = 8
_NOT_STATED = -1
_OWN_STEPS = {_NOT_STATED: 0, 3: 0, 11: 1, 6: 2}  # surface, original surface, raw surface: in this order of preference
_SOURCES = {0: "top", 1: "bottom", 2: "top left", 3: "top right"}


def scan_surface(arrays: Iterable[ArrayMessage]) -> ArrayMessage | None:
    """The scanner's own surface, a point cloud before a uniform surface; None if there is no surface at all.

    Raises ConfigError if only tools made surfaces, or where several surfaces could be the scan.
    """
    surfaces = [array for array in arrays if array.type in (SURFACE_POINTS, UNIFORM_SURFACE)]
    own = _own(surfaces)
    if surfaces and not own:
        raise ConfigError(
            f"the Gocator sends only outputs of tools ({_listed(surfaces)}); under Output > Ethernet tick the surface of the scanner itself"
        )
    chosen = _different([array for array in own if _preference(array) == min(map(_preference, own))])
    if len(chosen) > 1 or len({_source(array) for array in own}) > 1:
        raise ConfigError(
            f"the Gocator sends several surfaces for one scan ({_listed(own)}), and nobody can tell which one is meant; under "
            "Output > Ethernet tick one surface, of one source"
        )
    return chosen[0] if chosen else None


def scan_intensity(arrays: Iterable[ArrayMessage], surface: ArrayMessage) -> ArrayMessage | None:
    """The grey values that belong to ``surface``: of the same source, step and part where that is stated. Raises ConfigError."""
    images = [array for array in _own([a for a in arrays if a.type == SURFACE_INTENSITY]) if _source(array) == _source(surface)]
    exact = [array for array in images if _origin(array) == _origin(surface)]
    found = _different(exact or images)
    if len(found) > 1:
        raise ConfigError(f"the Gocator sends several intensity images of one scan ({_listed(found)}); under Output > Ethernet tick one")
    return found[0] if found else None


def _own(arrays: Sequence[ArrayMessage]) -> list[ArrayMessage]:
    return [array for array in arrays if _step(array) in _OWN_STEPS]


def _different(arrays: Sequence[ArrayMessage]) -> list[ArrayMessage]:
    """Without those that repeat another one to the last value: a message that came twice is no second surface."""
    found: list[ArrayMessage] = []
    for array in arrays:
        if not any(array.attributes == other.attributes and np.array_equal(array.array, other.array) for other in found):
            found.append(array)
            if len(found) > 1:
                break  # already ambiguous: no need to compare all with all
    return found


def _preference(array: ArrayMessage) -> tuple[bool, int]:
    return array.type != SURFACE_POINTS, _OWN_STEPS[_step(array)]


def _step(array: ArrayMessage) -> int:
    return array.attributes.get("stream_step", _NOT_STATED)


def _source(array: ArrayMessage) -> int:
    return array.attributes.get("source", 0)


def _origin(array: ArrayMessage) -> tuple[int, ...]:
    return _step(array), array.attributes.get("stream_step_id", 0), array.attributes.get("arrayed_index", 0)


def _listed(arrays: Sequence[ArrayMessage]) -> str:
    """At most three of them, for messages to people."""
    names = []
    for array in arrays[:3]:
        kind = "tool output" if _step(array) == TOOL_OUTPUT else TYPE_NAMES[array.type]
        source = _SOURCES.get(_source(array), f"number {_source(array)}")
        part = f", part {array.attributes['arrayed_index']}" if array.attributes.get("arrayed_count", 1) > 1 else ""
        names.append(f"{kind} of source {source}{part}")
    return ", ".join(names) + (", ..." if len(arrays) > 3 else "")
