"""The files for the controller agree with each other and with the driver's defaults."""

from importlib.resources import files

import pytest
from defusedxml.ElementTree import fromstring
from mbcacq_kuka.rsi.options import Options

FOLDER = files("mbcacq_kuka") / "controller"
PROGRAMS = ("rsi4/mbcacq_rsi.src", "rsi4/mbcacq_rsi.dat", "rsi3/mbcacq_rsi.src")
DEFAULTS = Options(limits_deg=((-1.0, 1.0),) * 6)


def read(name):
    return (FOLDER / name).read_bytes()


@pytest.mark.parametrize("name", [*PROGRAMS, "mbcacq_ethernet.xml", "rsi4/mbcacq.rsix", "rsi3/mbcacq.rsi.xml", "eki/EkiKSSinterface.xml"])
def test_plain_ascii(name):
    assert read(name).isascii()


def test_the_ethernet_file_is_what_the_driver_expects_by_default():
    root = fromstring(read("mbcacq_ethernet.xml"))
    assert root.findtext("CONFIG/SENTYPE") == DEFAULTS.sen_type
    assert int(root.findtext("CONFIG/PORT")) == DEFAULTS.port
    assert {"DEF_AIPos", "DEF_ASPos", "DEF_Delay", "DEF_MACur"} <= {e.get("TAG") for e in root.iter("ELEMENT")}
    received = {e.get("TAG"): (e.get("INDX"), e.get("HOLDON")) for e in root.find("RECEIVE/ELEMENTS")}
    assert received == {DEFAULTS.stop_element: ("1", "1")} | {f"{DEFAULTS.correction}.A{i}": (str(i + 1), "1") for i in range(1, 7)}


def wires(root, obj, ident, out_obj, first):
    """{(object, input): (source, output)} with both counted from 1."""
    return {(o.get(ident), int(i.get("InIdx")) + first): (i.get(out_obj), int(i.get("OutIdx")) + first) for o in root.iter(obj) for i in o.iter() if i.get("InIdx")}


def test_both_contexts_wire_the_same_channels():
    new = fromstring(read("rsi4/mbcacq.rsix"))
    old = fromstring(read("rsi3/mbcacq.rsi.xml"))
    found = wires(new, "{RsiDriver}RsiObject", "ObjId", "OutObjId", 1)
    assert found == {("AxisCorr_1", i): ("Ethernet_1", i + 1) for i in range(1, 7)} | {("Stop_1", 1): ("Ethernet_1", 1)}
    found = wires(old, "RSIObject", "ObjID", "OutObjID", 0)
    assert found == {("AXISCORR1", i): ("ETHERNET1", i + 1) for i in range(1, 7)} | {("STOP1", 1): ("ETHERNET1", 1)}


def test_the_program_sets_every_limit_of_the_context():
    source = read("rsi4/mbcacq_rsi.src").decode()
    root = fromstring(read("rsi4/mbcacq.rsix"))
    public = {(o.get("ObjId"), p.get("Name")) for o in root.iter("{RsiDriver}RsiObject") for p in o.iter("{RsiDriver}Parameter") if p.get("IsPublic")}
    assert len(public) == 18
    assert all(f'mbcacq_set("{o}","{p}",' in source for o, p in public)


@pytest.mark.parametrize("name", PROGRAMS)
def test_blocks_are_closed(name):
    lines = [line.split(";")[0].strip().upper() for line in read(name).decode().splitlines()]
    for begin, end in (("DEF ", "END"), ("IF ", "ENDIF"), ("FOR ", "ENDFOR"), ("DEFDAT ", "ENDDAT")):
        assert sum(line.startswith(begin) for line in lines) == lines.count(end)
    assert all(len(line) <= 24 for line in (w for text in lines for w in text.replace("(", " ").split() if w.startswith("MBCACQ")))
