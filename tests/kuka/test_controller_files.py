"""The files for the controller agree with each other and with the driver's defaults."""

import re
from importlib.resources import files
from xml.etree.ElementTree import tostring

import pytest
from defusedxml.ElementTree import fromstring
from mbcacq_kuka.rsi.driver import KukaRsi
from mbcacq_kuka.rsi.options import RsiOptions

FOLDER = files("mbcacq_kuka") / "controller"
PROGRAMS = ("rsi4/mbcacq_rsi.src", "rsi4/mbcacq_rsi.dat", "rsi3/mbcacq_rsi.src", "rsi_iiqka/mbcacq_rsi.src", "rsi_iiqka/mbcacq_rsi.dat")
DEFAULTS = RsiOptions(limits_deg=((-1.0, 1.0),) * 6)


def read(name):
    return (FOLDER / name).read_bytes()


@pytest.mark.parametrize("name", [*PROGRAMS, "mbcacq_ethernet.xml", "rsi4/mbcacq.rsix", "rsi3/mbcacq.rsi.xml"])
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
    return {
        (o.get(ident), int(i.get("InIdx")) + first): (i.get(out_obj), int(i.get("OutIdx")) + first)
        for o in root.iter(obj)
        for i in o.iter()
        if i.get("InIdx")
    }


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
    public = {
        (o.get("ObjId"), p.get("Name"))
        for o in root.iter("{RsiDriver}RsiObject")
        for p in o.iter("{RsiDriver}Parameter")
        if p.get("IsPublic")
    }
    assert len(public) == 18
    assert all(f'mbcacq_set("{o}","{p}",' in source for o, p in public)


@pytest.mark.parametrize("name", PROGRAMS)
def test_blocks_are_closed(name):
    lines = [line.split(";")[0].strip().upper() for line in read(name).decode().splitlines()]
    for begin, end in (("DEF ", "END"), ("IF ", "ENDIF"), ("FOR ", "ENDFOR"), ("DEFDAT ", "ENDDAT")):
        assert sum(line.startswith(begin) for line in lines) == lines.count(end)
    assert all(len(line) <= 24 for line in (w for text in lines for w in text.replace("(", " ").split() if w.startswith("MBCACQ")))


def test_the_three_files_of_old_rsi_say_the_same():
    """RSIVisual keeps a drawing (.rsi.diagram) and its model (.rsi) beside the file that is executed (.rsi.xml)."""
    options = {"limits_deg": [(-5, 5)] * 6}
    files = {name.split("/")[-1]: text for name, text in KukaRsi.controller_files("arm", "", options, {}).items() if "kss_older" in name}
    done = fromstring(files["mbcacq.rsi.xml"])
    model = fromstring(files["mbcacq.rsi"])
    ns = "{http://schemas.microsoft.com/dsltools/RSIVisual}"
    elements = {e.get("name"): e for e in model.iter(f"{ns}rSIElement")}
    executed = {o.get("ObjID"): o for o in done.iter("RSIObject")}
    assert {n: (e.get("objType"), e.get("objTypeID")) for n, e in elements.items()} == {
        n: (o.get("ObjType"), o.get("ObjTypeID")) for n, o in executed.items()
    }
    modes = {"ExitMoveCorr": "4", "Bit": "0"}
    for name, element in elements.items():
        values = {(p.get("name"), p.get("index")): modes.get(p.get("value"), p.get("value")) for p in element.iter(f"{ns}rSIParameter")}
        assert values == {(p.get("Name"), p.get("ParamID")): p.get("ParamValue") for p in executed[name].iter("Parameter")}
    linked = {
        (n, p.get("name")): source.get("name")
        for n, e in elements.items()
        for p in e.iter(f"{ns}rSIInPort")
        for source in p.iter(f"{ns}rSIOutPortMoniker")
    }
    wired = {(o, int(p.removeprefix("In").removeprefix("CorrA"))): tuple(s[2:].split("/Out")) for (o, p), s in linked.items()}
    executed_wires = wires(done, "RSIObject", "ObjID", "OutObjID", 0)
    assert {k: (source, str(out)) for k, (source, out) in executed_wires.items()} == wired
    expected = {("AXISCORR1", f"CorrA{i}"): f"//ETHERNET1/Out{i + 1}" for i in range(1, 7)} | {("STOP1", "In1"): "//ETHERNET1/Out1"}
    assert linked == expected

    drawing = fromstring(files["mbcacq.rsi.diagram"])
    ports = {shape.get("Id"): shape[0].get("name") for shape in drawing.iter() if shape.tag.endswith("PortShape")}
    assert len(set(ports)) == len(ports)
    drawn = {
        ports[c.find("nodes/rSIInPortShapeMoniker").get("Id")]: ports[c.find("nodes/rSIOutPortShapeMoniker").get("Id")]
        for c in drawing.iter("rSISignalConnector")
    }
    assert drawn == {f"//{obj}/{port}": source for (obj, port), source in linked.items()}
    shown = {p for shape in drawing.iter("rSIElementShape") for p in (m.get("name") for m in shape.iter() if m.tag.endswith("PortMoniker"))}
    assert shown == {
        f"//{n}/{p.get('name')}" for n, e in elements.items() for kind in ("rSIInPort", "rSIOutPort") for p in e.iter(f"{ns}{kind}")
    }


@pytest.mark.parametrize("system", ["kss85", "iiqka"])
def test_every_output_of_the_plan_is_written_and_read_back(system):
    """From the element of the answer through the signal flow to $OUT[n], and from there back into the telegram."""
    options = {"limits_deg": [(-5, 5)] * 6, "digital_outputs": [12, 3]}
    files = {
        name.split("/")[-1]: text for name, text in KukaRsi.controller_files("arm", "", options, {}).items() if name.startswith(system)
    }
    ethernet = fromstring(files["mbcacq_ethernet.xml"])
    sent, received = (
        {e.get("TAG"): (e.get("TYPE"), e.get("INDX"), e.get("HOLDON")) for e in ethernet.find(f"{part}/ELEMENTS")}
        for part in ("SEND", "RECEIVE")
    )
    context = fromstring(files["mbcacq.rsix"])
    flow = wires(context, "{RsiDriver}RsiObject", "ObjId", "OutObjId", 1)
    write, reads, link = "Map2DigOut_{}", "DigOut_{}", "Ethernet_1"
    parameters = {
        o.get("ObjId"): [p.get("ParamValue") for p in o.iter() if p.get("ParamValue")] for o in context.iter("{RsiDriver}RsiObject")
    }
    for number in (12, 3):
        kind, index, held = received[f"DiO.o{number}"]
        assert (kind, held) == ("BOOL", "0")  # a missing answer switches it off
        assert flow[write.format(number), 1] == (link, int(index))
        kind, index, _ = sent[f"Digout.o{number}"]
        assert kind == "LONG"
        assert flow[link, int(index)] == (reads.format(number), 1)
        assert parameters[write.format(number)] == parameters[reads.format(number)] == [str(number), "0"]  # one bit
    program = files["mbcacq_rsi.src"]
    for number in (12, 3):
        off = [m.start() for m in re.finditer(rf"^   \$OUT\[{number}\]=FALSE$", program, re.M)]
        begin, moving = re.search(r"ret = RSI_(PROCESS_)?ON\(", program).start(), program.index("RSI_MOVECORR()")
        assert len(off) == 2
        assert off[0] < begin < moving < off[1]


def test_the_files_of_old_rsi_switch_no_output_and_the_warning_says_so():
    plain, given = (
        KukaRsi.controller_files("arm", "", {"limits_deg": [(-5, 5)] * 6, "digital_outputs": outputs}, {}) for outputs in ([], [3])
    )
    old = {name for name in plain if name.startswith("kss_older")}
    assert {name: given[name] for name in old} == {name: plain[name] for name in old}
    assert "kss_older) switch no outputs" in given["WARNINGS.txt"]


def settable(context):
    """(object, parameter) that a program may set; those which the blueprints of RSI 6 fix once for all are not among them."""
    return {
        (o.get("ObjId"), p.get("Name"))
        for o in fromstring(context).iter("{RsiDriver}RsiObject")
        for p in o.iter("{RsiDriver}Parameter")
        if p.get("IsPublic") == "true"
    }


def test_iiqka_sets_what_its_context_lets_it_set_by_its_own_functions():
    kss, new = (read(f"{folder}/mbcacq_rsi.src").decode() for folder in ("rsi4", "rsi_iiqka"))
    sets = {program: set(re.findall(r'mbcacq_set\("(\w+)","(\w+)"', program)) for program in (kss, new)}
    assert sets[kss] == settable(read("rsi4/mbcacq.rsix"))
    assert sets[new] == settable(read("rsi_iiqka/mbcacq.rsix")) == {pair for pair in sets[kss] if pair[0] == "AxisCorr_1"}
    for old in ("RSI_CREATE", "RSI_ON(", "RSI_OFF", "RSI_DELETE", "RSI_SetPublicPar", "IR_STOPM", "contid"):
        assert old in kss
        assert old not in new
    for name in ("RSI_LOAD", "RSI_ACTIVATE", "RSI_PROCESS_ON(#ABSOLUTE)", "RSI_PROCESS_OFF", "RSI_SetParameter"):
        assert name in new


def test_the_monitor_of_rsi_6_is_out_of_the_way_and_fixed():
    root = fromstring(read("rsi_iiqka/mbcacq.rsix"))
    monitor = next(o for o in root.iter("{RsiDriver}RsiObject") if o.get("ObjType") == "AxisCorrMon")
    values = {p.get("Name"): (p.get("IsRuntime"), float(p.get("ParamValue"))) for p in monitor.iter("{RsiDriver}Parameter")}
    assert all(values[f"MaxA{i}"] == ("false", 1000.0) for i in range(1, 7))
    assert all(values[f"MaxE{i}"][0] == "false" for i in range(1, 7))


def test_all_contexts_but_for_the_monitor_are_the_same():
    def others(name):
        objects = fromstring(read(name)).iter("{RsiDriver}RsiObject")
        return [tostring(o) for o in objects if o.get("ObjType") != "AxisCorrMon"]

    assert others("rsi4/mbcacq.rsix") == others("rsi_iiqka/mbcacq.rsix")
