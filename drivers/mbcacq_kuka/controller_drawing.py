"""The drawing that RSIVisual shows of a context before RSI 4.1, with the objects of the plan's digital outputs in it (inches)."""

from __future__ import annotations

import re
import uuid
from collections.abc import Sequence

from mbcacq_kuka.controller_outputs import inserted

_FAMILY = uuid.UUID("5d6c9a3e-0a37-4c0b-9d1c-3f6b7a2e9c11")  # the same plan gives the same file
_PITCH, _ROW = 0.4, 1.2  # from one port of an object to the next, from one small object to the next
_WIDTH, _HEIGHT = 1.5, 0.9  # of a small object
_LEFT, _RIGHT = 1.25, 8.375  # of what is before and behind ETHERNET1
_TOP_LEFT, _TOP_RIGHT = 2.25, 6.5
_IN, _OUT, _FIRST = 3.85, 5.75, 2.5  # ports of ETHERNET1: left, right, and the upper end of the first ones
_TAKEN = 7


def in_old_drawing(text: str, numbers: Sequence[int]) -> str:
    """The drawing, with DIGOUT before ETHERNET1 and MAP2DIGOUT behind it, a pair an output."""
    if not numbers:
        return text
    ins = "".join(_port("In", f"ETHERNET1/In{k + 1}", _IN, _FIRST + _PITCH * k) for k in range(1, len(numbers) + 1))
    outs, shapes, wires = "", "", ""
    for k, number in enumerate(numbers):
        left, right = _TOP_LEFT + _ROW * k, _TOP_RIGHT + _ROW * k
        there = _FIRST + _PITCH * (_TAKEN + k)
        outs += _port("Out", f"ETHERNET1/Out{_TAKEN + k + 1}", _OUT, there)
        shapes += _shape(f"DIGOUT{number}", _LEFT, left, _port("Out", f"DIGOUT{number}/Out1", _LEFT + _WIDTH, left + 0.25))
        shapes += _shape(f"MAP2DIGOUT{number}", _RIGHT, right, _port("In", f"MAP2DIGOUT{number}/In1", _RIGHT - _PITCH, right + 0.25))
        first_in = re.search(r'Id="([^"]+)"[^>]*>\s*<rSIInPortMoniker name="//ETHERNET1/In1"', text)
        assert first_in is not None  # it is one of the shipped files
        inside = first_in[1] if k == 0 else _identity(f"ETHERNET1/In{k + 1}")
        at_in, at_out = (_IN, _FIRST + _PITCH * k), (_LEFT + _WIDTH + _PITCH, left + 0.25)
        wires += _wire(inside, at_in, _identity(f"DIGOUT{number}/Out1"), at_out)
        at_in, at_out = (_RIGHT - _PITCH, right + 0.25), (_OUT + _PITCH, there)
        wires += _wire(_identity(f"MAP2DIGOUT{number}/In1"), at_in, _identity(f"ETHERNET1/Out{_TAKEN + k + 1}"), at_out)
    text = _lowered(text, _PITCH * len(numbers))
    text = inserted(text, ins, before=_start_of_port(text, "//ETHERNET1/Out1"))
    text = inserted(text, outs, after=_whole_port(text, f"//ETHERNET1/Out{_TAKEN}"))
    text = text.replace('absoluteBounds="4.25, 2.25, 1.5, 3.3"', f'absoluteBounds="4.25, 2.25, 1.5, {3.3 + _PITCH * len(numbers):g}"', 1)
    text = inserted(text, shapes, before="    <rSISignalConnector ")
    lowest = max(12.0 + _PITCH * len(numbers), _TOP_RIGHT + _ROW * len(numbers) + 1.0)
    text = text.replace('absoluteBounds="0, 0, 11, 12"', f'absoluteBounds="0, 0, 11, {lowest:g}"', 1)
    return inserted(text, wires, before="  </nestedChildShapes>\n</rSIObjectDiagram>")


def _identity(name: str) -> str:
    return str(uuid.uuid5(_FAMILY, name))


def _bounds(*values: float) -> str:
    return ", ".join(f"{round(v, 4):g}" for v in values)


def _port(kind: str, name: str, x: float, y: float) -> str:
    return (
        f'        <rSI{kind}PortShape Id="{_identity(name)}" absoluteBounds="{_bounds(x, y, _PITCH, 0.075)}" fillColor="White">\n'
        f'          <rSI{kind}PortMoniker name="//{name}" />\n          <relativeChildShapes />\n        </rSI{kind}PortShape>\n'
    )


def _shape(name: str, x: float, y: float, port: str) -> str:
    inner = _bounds(x + 0.015, y + 0.51, 1.47, 0.25)
    return (
        f'    <rSIElementShape Id="{_identity(name)}" absoluteBounds="{_bounds(x, y, _WIDTH, _HEIGHT)}" fillColor="BlanchedAlmond">\n'
        f'      <rSIElementMoniker name="//{name}" />\n      <relativeChildShapes>\n{port}      </relativeChildShapes>\n'
        f'      <nestedChildShapes>\n        <elementListCompartment Id="{_identity(name + "/parameters")}" absoluteBounds="{inner}" '
        'name="RSIParameters" titleTextColor="Black" itemTextColor="Black" />\n      </nestedChildShapes>\n    </rSIElementShape>\n'
    )


def _wire(in_id: str, to: tuple[float, float], out_id: str, source: tuple[float, float]) -> str:
    """From a port of the object on the left to one of the object on the right, with a step half-way."""
    (x, y), (u, v), middle = to, source, to[0] - 0.375
    y, v = y + 0.0375, v + 0.0375
    points = "; ".join(f"({round(a, 4):g} : {round(b, 4):g})" for a, b in ((x, y), (middle, y), (middle, v), (u, v)))
    return (
        f'    <rSISignalConnector edgePoints="[{points}]" fixedFrom="Caller" fixedTo="Caller" '
        'TargetRelationshipDomainClassId="e3f2b7da-330d-4daf-bd29-4d4ed734c0af">\n      <nodes>\n'
        f'        <rSIInPortShapeMoniker Id="{in_id}" />\n        <rSIOutPortShapeMoniker Id="{out_id}" />\n'
        "      </nodes>\n    </rSISignalConnector>\n"
    )


def _start_of_port(text: str, name: str) -> str:
    return _whole_port(text, name).split("\n", 1)[0]


def _whole_port(text: str, name: str) -> str:
    found = re.search(rf' *<rSI(\w+)PortShape [^>]*>\n *<rSI\w+Moniker name="{name}" />\n.*\n *</rSI\1PortShape>\n', text)
    assert found is not None  # it is one of the shipped files
    return found[0]


def _lowered(text: str, by: float) -> str:
    """AXISCORRMON1, below ETHERNET1, makes room for its ports."""
    name = text.index('<rSIElementMoniker name="//AXISCORRMON1" />')
    begin = text.rindex("<rSIElementShape ", 0, name)
    end = text.index("</rSIElementShape>", begin)

    def lower(m: re.Match[str]) -> str:
        x, y, *size = map(float, m[1].split(","))
        return f'absoluteBounds="{_bounds(x, y + by, *size)}"'

    return text[:begin] + re.sub(r'absoluteBounds="([^"]*)"', lower, text[begin:end]) + text[end:]
