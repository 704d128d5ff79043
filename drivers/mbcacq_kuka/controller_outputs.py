"""Digital outputs in the files of RSI: each $OUT[n] of the plan is written by an object MAP2DIGOUT, and read back by an object DIGOUT.

An answer that is missing switches them off (HOLDON="0"): what ends the answers must not hold an output. The program switches them off at
its beginning and at its end. Object identifiers, ports and parameters are those of KUKA's own contexts; one bit an object, so that Index
is the number of the output.
"""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq_kuka.rsi.telegram import REPORT_ELEMENT, SWITCH_ELEMENT, output_attribute

_TAKEN = 7  # outputs of the ETHERNET object without these: Stop and six axes
_OLD_PARAMETERS = (
    '      <Parameter Name="Index" ParamID="1" ParamValue="{number}" />\n      <Parameter Name="DataSize" ParamID="2" ParamValue="0" />\n'
)
_OLD_INPUT = '      <Input InIdx="{to}" OutObjID="{source}" OutIdx="{out}" />\n'
_NEW_PARAMETERS = (
    '            <Parameter Name="Index" ParamId="0" ParamValue="{number}" />\n'
    '            <Parameter Name="DataType" ParamId="1" ParamValue="0" />\n'
)
_NEW_INPUT = '            <Input InIdx="{to}" OutObjId="{source}" OutIdx="{out}" />\n'
_MODEL_PARAMETERS = (
    '        <rSIParameter name="Index" value="{number}" paramType="System.Int32" minVal="1" maxVal="4096" isEnum="false" index="1" />\n'
    '        <rSIParameter name="DataSize" value="Bit" paramType="KUKA.RSIVisual.{kind}" minVal="-2147483648" maxVal="2147483647" '
    'isEnum="true" index="2" />\n'
)


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
    inputs = "".join(_NEW_INPUT.format(to=k, source=f"DigOut_{n}", out=0) for k, n in enumerate(numbers))
    objects = ""
    for k, n in enumerate(numbers):
        source = _NEW_INPUT.format(to=0, source="Ethernet_1", out=_TAKEN + k)
        objects += _new_object(43, "DigOut", n, "") + _new_object(14, "Map2DigOut", n, source)
    head = '      <RsiObject ObjTypeId="64" ObjType="Ethernet" ObjId="Ethernet_1">\n'
    text = inserted(text, f"         <Inputs>\n{inputs}         </Inputs>\n", after=head)
    return inserted(text, objects, before="   </RsiObjects>")


def in_old_context(text: str, numbers: Sequence[int]) -> str:
    """The executed file of a context before RSI 4.1; counted from 1."""
    if not numbers:
        return text
    inputs = "".join(_OLD_INPUT.format(to=k, source=f"DIGOUT{n}", out=1) for k, n in enumerate(numbers, 1))
    head = '  <RSIObject ObjType="ETHERNET" ObjTypeID="64" ObjID="ETHERNET1">\n'
    text = inserted(text, "".join(_old_object(43, "DIGOUT", n, "") for n in numbers), before=head)
    text = inserted(text, f"    <Inputs>\n{inputs}    </Inputs>\n", after=head)
    written = ""
    for k, n in enumerate(numbers, 1):
        written += _old_object(14, "MAP2DIGOUT", n, _OLD_INPUT.format(to=1, source="ETHERNET1", out=_TAKEN + k))
    return inserted(text, written, before="</RSIObjects>")


def in_old_model(text: str, numbers: Sequence[int]) -> str:
    """The model that RSIVisual keeps beside it."""
    if not numbers:
        return text
    spare = '        <rSIInPort name="In1" mandatory="false" />\n'
    used = "".join(_in_port(f'name="In{k}" mandatory="false"', f"//DIGOUT{n}/Out1") for k, n in enumerate(numbers, 1))
    text = inserted(text.replace(spare, spare.replace("In1", f"In{len(numbers) + 1}"), 1), used, before='        <rSIInPort name="In')
    outs = "".join(f'        <rSIOutPort name="Out{_TAKEN + k}" />\n' for k in range(1, len(numbers) + 1))
    text = inserted(text, outs, after=f'        <rSIOutPort name="Out{_TAKEN}" />\n')
    objects = ""
    for k, n in enumerate(numbers, 1):
        out = '      <rSIOutPorts>\n        <rSIOutPort name="Out1" signalType="Int" />\n      </rSIOutPorts>\n'
        objects += _element("DIGOUT", 43, n, out, "RSI_DataSize")
        source = _in_port('name="In1" signalType="Int"', f"//ETHERNET1/Out{_TAKEN + k}")
        objects += _element("MAP2DIGOUT", 14, n, f"      <rSIInPorts>\n{source}      </rSIInPorts>\n", "RSI_DataSizeX")
    return inserted(text, objects, before="  </rSIObjects>")


def inserted(text: str, piece: str, before: str = "", after: str = "") -> str:
    """text with a piece put before, or after, the first place that reads so. Raises AssertionError where there is none."""
    place = text.find(before or after)
    if place < 0:
        raise AssertionError(f"{before or after!r} does not stand in the file")
    place += len(after)
    return text[:place] + piece + text[place:]


def _new_object(kind: int, name: str, number: int, source: str) -> str:
    inputs = f"         <Inputs>\n{source}         </Inputs>\n" if source else ""
    return (
        f'      <RsiObject ObjTypeId="{kind}" ObjType="{name}" ObjId="{name}_{number}">\n{inputs}'
        f"         <Parameters>\n{_NEW_PARAMETERS.format(number=number)}         </Parameters>\n      </RsiObject>\n"
    )


def _old_object(kind: int, name: str, number: int, source: str) -> str:
    inputs = f"    <Inputs>\n{source}    </Inputs>\n" if source else ""
    return (
        f'  <RSIObject ObjType="{name}" ObjTypeID="{kind}" ObjID="{name}{number}">\n{inputs}'
        f"    <Parameters>\n{_OLD_PARAMETERS.format(number=number)}    </Parameters>\n  </RSIObject>\n"
    )


def _in_port(about: str, source: str) -> str:
    return (
        f"        <rSIInPort {about}>\n          <source>\n"
        f'            <rSIOutPortMoniker name="{source}" />\n          </source>\n        </rSIInPort>\n'
    )


def _element(name: str, kind: int, number: int, ports: str, size: str) -> str:
    return (
        f'    <rSIElement name="{name}{number}" objType="{name}" objTypeID="{kind}" maxInputs="0" maxOutputs="0">\n{ports}'
        f"      <rSIParameters>\n{_MODEL_PARAMETERS.format(number=number, kind=size)}      </rSIParameters>\n    </rSIElement>\n"
    )
