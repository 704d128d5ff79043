"""Programs, channel files and driver agree on every tag, channel, flag and type; both systems run the same logic."""

import re
from xml.etree.ElementTree import fromstring as parse_xml

import pytest
from eki_bench import FOLDER, SYSTEMS, sources, text
from mbcacq_fakes.protocols.krc.eki_config import read_config
from mbcacq_kuka.eki import telegrams
from mbcacq_kuka.eki.options import EkiOptions
from mbcacq_kuka.eki.telegrams import REFUSALS, SWITCH_REFUSALS, State

CALL = re.compile(r'EKI_(\w+?)(?:\((\w+|"[^"]*")(?:,"([^"]*)")?)', re.I)
WORDS = {"int": "INT", "real": "REAL", "string": "STRING", "frame": "FRAME", "bool": "BOOL"}
CONFIG = {system: read_config(text(f"eki_{system}/mbcacq_eki.xml")) for system in SYSTEMS}


def calls(system):
    """(function, channel, tag or '') of every EKI call in the programs."""
    return [(f.lower(), channel.strip('"'), tag) for f, channel, tag in CALL.findall(text(f"eki_{system}/mbcacq_link.src"))]


@pytest.mark.parametrize("system", SYSTEMS)
def test_what_the_program_gets_and_sets_is_what_the_channel_declares(system):
    config = CONFIG[system]
    got = {tag: WORDS[f[3:]] for f, _, tag in calls(system) if f.startswith("get")}
    assert got == {name: kind for name, (_, kind) in config.received.items()}
    put = {tag: WORDS[f[3:]] for f, _, tag in calls(system) if f.startswith("set")}
    assert set(put) == set(config.sent)
    if system == "iiqka":
        assert put == config.sent


@pytest.mark.parametrize("system", SYSTEMS)
def test_one_channel_named_as_its_file(system):
    assert {channel for _, channel, _ in calls(system)} == {"mbcacq_eki"}
    assert (FOLDER / f"eki_{system}" / "mbcacq_eki.xml").is_file()


@pytest.mark.parametrize("system", SYSTEMS)
def test_flags_of_the_channel_are_those_the_program_watches(system):
    config, program = CONFIG[system], text(f"eki_{system}/mbcacq_link.src") + text("eki_kss/mbcacq_eki.src")
    used = {int(n) for n in re.findall(r"\$FLAG\[(\d+)\]", re.sub(r";.*", "", program))}
    raised = {*config.flags.values(), *filter(None, (config.alive, config.lost))}
    assert raised == ({120, 121} if system == "kss" else {121, 124})
    assert used == raised | {122, 123}


def paths(element, above=""):
    """All values of a telegram as EKI names them."""
    here = f"{above}/{element.tag}".lstrip("/")
    found = {f"{here}/@{a}" for a in element.attrib}
    for child in element:
        found |= paths(child, here)
    return found


def test_the_driver_sends_every_value_that_is_received_and_no_other():
    sent = paths(parse_xml(telegrams.command(telegrams.PTP, 1, 2, 3.0, 4)))
    assert {path for path, _ in CONFIG["iiqka"].received.values()} == sent
    assert {path for path, _ in CONFIG["kss"].received.values()} == sent


def test_the_driver_reads_exactly_what_both_systems_send():
    template = re.sub(r"\$\$\w+:String\$\$", "x", re.sub(r"\$\$\w+:(?:Int|Real)\$\$", "1", CONFIG["iiqka"].template))
    hello, state = telegrams.parse(template.encode())
    assert hello is not None
    assert state is not None
    sent = paths(parse_xml(template))
    frames = {tag for tag in CONFIG["kss"].order if f"{tag}/@X" in sent}
    assert {p for tag in CONFIG["kss"].order for p in ([f"{tag}/@{a}" for a in "XYZABC"] if tag in frames else [tag])} == sent
    attributes = {p.split("@")[1] for p in sent if p.startswith("Robot/State/@")}
    assert attributes == {name.title().replace("_", "") for name, kind in State.__annotations__.items() if kind in ("int", "float")}
    of_before = {"Robot/State/@Switched", "Robot/State/@SwitchCode"}  # do not know them
    for missing in sorted(sent - of_before - {"Robot/Hello/@Interface", "Robot/Hello/@MachineData", "Robot/Hello/@Model"}):
        element, attribute = missing.split("/@")
        cut = re.sub(rf'(<{element.split("/")[-1]}\b[^>]*?) {attribute}="1"', r"\1", template, count=1)
        assert cut != template
        with pytest.raises(telegrams.BadTelegram, match=attribute):
            telegrams.parse(cut.encode())


def test_the_codes_of_a_switch():
    program = text("eki_kss/mbcacq_link.src").split("DEF mb_link_switch(")[1].split("\nEND\n")[0]
    assert {int(c) for c in re.findall(r"mb_swcode=(\d+)", program)} - {0} == set(SWITCH_REFUSALS)


def test_the_codes_of_a_refusal():
    program = text("eki_kss/mbcacq_link.src")
    assert {int(c) for c in re.findall(r"RETURN \((\d+)\)", program.split("mb_link_check(")[2].split("ENDFCT")[0])} - {0} == set(REFUSALS)


def test_both_systems_run_the_same_logic():
    """Line by line, all but the EKI calls themselves and what watches the connection."""

    def logic(system):
        lines = [re.sub(r";.*", "", line).strip() for line in text(f"eki_{system}/mbcacq_link.src").splitlines()]
        body = "\n".join(lines)
        cut = [body.index("DEF mb_link_stop"), len(body)]
        return [
            line
            for line in body[cut[0] : cut[1]].splitlines()
            if line
            and "EKI" not in line.upper()
            and not line.startswith(("WHILE ret", "DECL FRAME here", "here="))
            and line != "DECL INT ret"
        ]

    assert logic("kss") == logic("iiqka")


def test_the_numbers_in_the_data_list_are_the_drivers_defaults():
    data = text("eki_kss/mbcacq_eki.dat")
    options = EkiOptions(address="1.2.3.4", limits_deg=((-5.0, 5.0),) * 6, speed_deg_s=(1.0,) * 6)
    found = dict(re.findall(r"(mb_\w+)=(-?[\d.]+)$", data, re.M))
    assert (int(found["mb_tool"]), int(found["mb_base"])) == (options.tool, options.base)
    assert int(found["mb_max_acc"]) == options.acceleration_percent
    assert (int(found["mb_silence"]), int(found["mb_period"])) == (options.controller_silence_ms, options.state_ms)
    assert CONFIG["kss"].port == CONFIG["iiqka"].port == options.port


def names_in(program):
    return {w.lower() for w in re.findall(r"\bmb\w*", re.sub(r'"[^"]*"|;.*', "", program), re.I)}


@pytest.mark.parametrize("system", SYSTEMS)
def test_every_variable_is_declared_and_used_and_names_fit(system):
    files = sources(system)
    declared = {w.lower() for w in re.findall(r"DECL GLOBAL \w+ (\w+)", files["mbcacq_eki.dat"])}
    used = names_in(files["mbcacq_eki.src"]) | names_in(files["mbcacq_link.src"])
    assert declared <= used
    assert all(len(name) <= 24 for name in used | declared)
    assert all(len(line) <= 140 and line.isascii() for t in files.values() for line in t.splitlines())
