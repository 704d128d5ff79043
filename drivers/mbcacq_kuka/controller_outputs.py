"""Digital outputs in the files of RSI: each $OUT[n] of the plan is written by an object MAP2DIGOUT, and read back by an object DIGOUT.

An answer that is missing switches them off (HOLDON="0"): what ends the answers must not hold an output. The program switches them off at
its beginning and at its end. Object identifiers, ports and parameters are those of KUKA's own contexts; one bit an object, so that Index
is the number of the output.
"""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq_kuka.rsi.telegram import REPORT_ELEMENT, SWITCH_ELEMENT, output_attribute

_TAKEN = 7  # outputs of the ETHERNET object without these: Stop and six axes
_PARAMETERS = (
    '            <Parameter Name="Index" ParamId="0" ParamValue="{number}" />\n'
    '            <Parameter Name="DataType" ParamId="1" ParamValue="0" />\n'
)
_INPUT = '            <Input InIdx="{to}" OutObjId="{source}" OutIdx="{out}" />\n'


def in_ethernet(text: str, numbers: Sequence[int]) -> str:
    """The ETHERNET configuration of all RSI generations."""
    sent = "".join(
        f'         <ELEMENT TAG="{REPORT_ELEMENT}.{output_attribute(n)}" TYPE="LONG" INDX="{k}"/>\n' for k, n in enumerate(numbers, 1)
    )
    received = "".join(
        f'         <ELEMENT TAG="{SWITCH_ELEMENT}.{output_attribute(n)}" TYPE="BOOL" INDX="{_TAKEN + k}" HOLDON="0"/>\n'
        for k, n in enumerate(numbers, 1)
    )
    if numbers:
        received = '         <!-- HOLDON="0": a missing answer switches the outputs off -->\n' + received
    end = "      </ELEMENTS>\n"
    return inserted(inserted(text, sent, before=end + "   </SEND>"), received, before=end + "   </RECEIVE>")


def in_program(text: str, numbers: Sequence[int], start: str) -> str:
    """A KRL program. start: how its line begins that starts RSI."""
    off = "".join(f"   $OUT[{n}]=FALSE\n" for n in numbers)
    begin = f"   ; what mbcacq switches is off before and afterwards\n{off}\n" if off else ""
    text = inserted(text, begin, before=f"   ret = {start}")
    return inserted(text, off, after="   RSI_MOVECORR()\n")


def in_context(text: str, numbers: Sequence[int]) -> str:
    """A context of RSI 4.1 and later; counted from 0."""
    if not numbers:
        return text
    inputs = "".join(_INPUT.format(to=k, source=f"DigOut_{n}", out=0) for k, n in enumerate(numbers))
    objects = ""
    for k, n in enumerate(numbers):
        source = _INPUT.format(to=0, source="Ethernet_1", out=_TAKEN + k)
        objects += _object(43, "DigOut", n, "") + _object(14, "Map2DigOut", n, source)
    head = '      <RsiObject ObjTypeId="64" ObjType="Ethernet" ObjId="Ethernet_1">\n'
    text = inserted(text, f"         <Inputs>\n{inputs}         </Inputs>\n", after=head)
    return inserted(text, objects, before="   </RsiObjects>")


def inserted(text: str, piece: str, before: str = "", after: str = "") -> str:
    """text with a piece put before, or after, the first place that reads so. Raises AssertionError where there is none."""
    place = text.find(before or after)
    if place < 0:
        raise AssertionError(f"{before or after!r} does not stand in the file")
    place += len(after)
    return text[:place] + piece + text[place:]


def _object(kind: int, name: str, number: int, source: str) -> str:
    inputs = f"         <Inputs>\n{source}         </Inputs>\n" if source else ""
    return (
        f'      <RsiObject ObjTypeId="{kind}" ObjType="{name}" ObjId="{name}_{number}">\n{inputs}'
        f"         <Parameters>\n{_PARAMETERS.format(number=number)}         </Parameters>\n      </RsiObject>\n"
    )
