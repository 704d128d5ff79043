"""The files for the controller, with a plan's addresses, limits and tool data in them. Path -> text, all of it plain ASCII."""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from mbcacq.devices import ConfigError
from mbcacq_kuka import controller_external as external
from mbcacq_kuka import controller_outputs as outputs
from mbcacq_kuka.controller_flags import with_flags_from
from mbcacq_kuka.controller_guide import eki_guide, rsi_guide
from mbcacq_kuka.eki.options import EkiOptions as EkiOptions
from mbcacq_kuka.rsi.options import RsiOptions as RsiOptions

_MARGIN_DEG = 0.001  # REAL has 32 bits: a target on the limit must not be refused for its last digit
_TECHNOLOGY = '         <ELEMENT TAG="DEF_Tech.C2" TYPE="DOUBLE" INDX="INTERNAL"/>\n'  # load, tool, base; iiQKA.OS2 has no $TECHPAR_C
_EKI_PORTS = range(54600, 54616)


def eki_files(options: EkiOptions, facts: Mapping[str, Any]) -> dict[str, str]:
    """For KSS (EKI 2, 3) and iiQKA.OS2 (EKI 6). facts: 'plan', 'robot', 'speed_share' (0..1), 'tool_frame' (X..C, mm, deg), 'load_kg',
    'load_centre_mm'. Raises ConfigError."""
    address = _address("address", options.address)
    if options.port not in _EKI_PORTS:
        raise ConfigError(f"port {options.port} is not one of the controller's (54600 to 54615); set option port in the plan")
    data = _fill_data(
        _read("eki_kss/mbcacq_eki.dat"),
        {
            "mb_tool": options.tool,
            "mb_base": options.base,
            "mb_max_vel": max(1, int(100.0 * facts.get("speed_share", 0.3) + 1e-6)),
            "mb_max_acc": options.acceleration_percent,
            "mb_silence": options.controller_silence_ms,
            "mb_period": options.state_ms,
            **{f"mb_out[{k}]": number for k, number in enumerate(options.digital_outputs, 1)},
            **_limits("mb_low", "mb_high", options.limits_deg),
        },
    )
    program = _read("eki_kss/mbcacq_eki.src")
    kss = _replace(_replace(_read("eki_kss/mbcacq_eki.xml"), "<IP>", address, "</IP>"), "<PORT>", options.port, "</PORT>")
    link = _read("eki_kss/mbcacq_link.src")
    new = _replace(_read("eki_iiqka/mbcacq_eki.xml"), '<Server Port="', options.port, '"')
    if options.external_axes:
        kss, data, program, link = (external.moved(text, options) for text in (kss, data, program, link))
    programs = {
        "kss/EthernetKRL/mbcacq_eki.xml": kss,
        "kss/Program/mbcacq_eki.dat": data,
        "kss/Program/mbcacq_eki.src": program,
        "kss/Program/mbcacq_link.src": link,
        "kss/System/mbcacq_link_sub.sub": _read("eki_kss/mbcacq_link_sub.sub"),
        "iiqka/EthernetKRL/mbcacq_eki.xml": new,
        "iiqka/Program/mbcacq_eki.dat": data,
        "iiqka/Program/mbcacq_eki.src": _for_iiqka(program),
        "iiqka/Program/mbcacq_link.src": _read("eki_iiqka/mbcacq_link.src"),
    }
    if options.external_axes:
        programs = {name: text for name, text in programs.items() if name.startswith("kss/")}
    warnings = ["the programs for iiQKA move no external axes and are left out"] if options.external_axes else []
    warnings += _warn_of_loopback("address", address, "of the controller, as this computer sees it")
    return {
        **_warnings_file(warnings),
        "README.txt": eki_guide(options, facts, warnings),
        "tool_data.txt": tool_data(options.tool, facts),
        **with_flags_from(options.first_flag, programs),
    }


def rsi_files(options: RsiOptions, facts: Mapping[str, Any]) -> dict[str, str]:
    """For RSI 4.1 and later (one context file), earlier RSI (three), and iiQKA.OS2 (RSI 6, a context of its own).

    facts: as for eki_files. Raises ConfigError."""
    if not options.stop_element:
        raise ConfigError("the files for the controller need the option stop_element (Stop); leave it out of the plan")
    address, ethernet = _address("bind", options.bind), _ethernet(options)
    warnings = _warn_of_loopback("bind", address, "of the network card that is wired to the controller's RSI interface")
    cycle = "#IPO_FAST" if options.cycle_ms == 4 else "#IPO"
    limits = _limits("lim_low", "lim_high", options.limits_deg)
    reach = options.correction_limit_deg or (20.0,) * 6
    numbers = options.digital_outputs
    if numbers:
        warnings.append("the files for RSI before 4.1 (kss_older) switch no outputs; take driver kuka-eki there")
    programs = {folder: _read(f"{folder}/mbcacq_rsi.src").replace("#IPO_FAST", cycle) for folder in ("rsi4", "rsi3")}
    return {
        **_warnings_file(warnings),
        "README.txt": rsi_guide(options, facts, reach, warnings),
        "tool_data.txt": tool_data(1, facts),
        "kss85/SensorInterface/mbcacq_ethernet.xml": outputs.in_ethernet(ethernet, numbers),
        "kss85/SensorInterface/mbcacq.rsix": outputs.in_context(_read("rsi4/mbcacq.rsix"), numbers),
        "kss85/Program/mbcacq_rsi.src": outputs.in_program(programs["rsi4"], numbers, "RSI_ON("),
        "kss85/Program/mbcacq_rsi.dat": _fill_data(_read("rsi4/mbcacq_rsi.dat"), limits),
        "kss_older/SensorInterface/mbcacq_ethernet.xml": ethernet,
        "kss_older/SensorInterface/mbcacq.rsi": _reach(_read("rsi3/mbcacq.rsi"), reach),
        "kss_older/SensorInterface/mbcacq.rsi.xml": _reach(_read("rsi3/mbcacq.rsi.xml"), reach),
        "kss_older/SensorInterface/mbcacq.rsi.diagram": _read("rsi3/mbcacq.rsi.diagram"),
        "kss_older/Program/mbcacq_rsi.src": programs["rsi3"],
        "iiqka/Ethernet configuration/mbcacq_ethernet.xml": outputs.in_ethernet(ethernet.replace(_TECHNOLOGY, ""), numbers),
        "iiqka/Context/mbcacq.rsix": outputs.in_context(_read("rsi_iiqka/mbcacq.rsix"), numbers),
        "iiqka/Program/mbcacq_rsi.src": outputs.in_program(_read("rsi_iiqka/mbcacq_rsi.src"), numbers, "RSI_PROCESS_ON("),
        "iiqka/Program/mbcacq_rsi.dat": _fill_data(_read("rsi_iiqka/mbcacq_rsi.dat"), limits),
    }


def tool_data(number: int, facts: Mapping[str, Any]) -> str:
    """The plan's tool as lines of ``$config.dat``; to be typed in or merged by hand, never written over."""
    if not 1 <= number <= 128:
        return "; tool 0 is the flange itself: nothing to enter\n"
    frame, centre = facts.get("tool_frame", (0.0,) * 6), facts.get("load_centre_mm", (0.0,) * 3)
    names = dict(zip(("X", "Y", "Z", "A", "B", "C"), frame, strict=True))
    data = ",".join(f"{k} {v:.4f}" for k, v in names.items())
    where = ",".join(f"{k} {v:.1f}" for k, v in zip(("X", "Y", "Z", "A", "B", "C"), (*centre, 0.0, 0.0, 0.0), strict=True))
    return (
        f"; tool {number} of the plan: X Y Z in mm, A B C in deg; load in kg, mm (moments of inertia: from your drawing)\n"
        f"TOOL_DATA[{number}]={{{data}}}\n"
        f'TOOL_NAME[{number},]="mbcacq scanner"\n'
        f"LOAD_DATA[{number}]={{M {facts.get('load_kg', 0.0):.3f},CM {{{where}}},J {{X 0.0,Y 0.0,Z 0.0}}}}\n"
    )


def _for_iiqka(program: str) -> str:
    """The robot program without the message interrupt of KSS, which iiQKA.OS2 does not have, and with its flag in the comment."""
    program = program.replace("$FLAG[120] computer connected (EKI)", "$FLAG[124] connection lost (EKI)    ")
    return "".join(line for line in program.splitlines(keepends=True) if "INTERRUPT DECL 3 " not in line and "INTERRUPT ON 3\n" not in line)


def _ethernet(options: RsiOptions) -> str:
    """The ETHERNET configuration of all RSI generations, without outputs."""
    text = _replace(_read("mbcacq_ethernet.xml"), "<IP_NUMBER>", _address("bind", options.bind), "</IP_NUMBER>")
    text = _replace(_replace(text, "<PORT>", options.port, "</PORT>"), "<SENTYPE>", options.sen_type, "</SENTYPE>")
    text = text.replace('TAG="AK.', f'TAG="{options.correction}.').replace('TAG="Stop"', f'TAG="{options.stop_element}"')
    delay = '         <ELEMENT TAG="DEF_Delay"'
    external = "".join(f'         <ELEMENT TAG="{tag}" TYPE="DOUBLE" INDX="INTERNAL"/>\n' for tag in ("DEF_EIPos", "DEF_MECur"))
    text = text.replace(delay, external + delay) if options.external_axes else text
    return text


def _warn_of_loopback(option: str, address: str, what: str) -> list[str]:
    found = ipaddress.IPv4Address(address)
    if not found.is_loopback and not found.is_unspecified:
        return []
    return [f"option {option} is {address}, which no controller can reach or be; give the address {what}"]


def _warnings_file(warnings: list[str]) -> dict[str, str]:
    return {"WARNINGS.txt": "".join(f"{text}\n" for text in warnings)} if warnings else {}


def _read(name: str) -> str:
    return (files("mbcacq_kuka") / "controller" / name).read_text(encoding="ascii")


def _address(option: str, value: str) -> str:
    try:
        return str(ipaddress.IPv4Address(value))
    except ValueError:
        raise ConfigError(f"the controller needs an address in numbers, option {option} is '{value}'; give an IPv4 address") from None


def _limits(low: str, high: str, limits: tuple[tuple[float, float], ...]) -> dict[str, float]:
    lower = {f"{low}[{k + 1}]": round(pair[0] - _MARGIN_DEG, 4) for k, pair in enumerate(limits)}
    return lower | {f"{high}[{k + 1}]": round(pair[1] + _MARGIN_DEG, 4) for k, pair in enumerate(limits)}


def _fill_data(text: str, values: Mapping[str, int | float]) -> str:
    """A data list with other values for some of its variables."""
    for name, value in values.items():
        pattern = re.compile(rf"^(\s*(?:DECL\s+(?:GLOBAL\s+)?(?:INT|REAL)\s+)?{re.escape(name)}=).*$", re.M)
        text, count = pattern.subn(lambda m, value=value: f"{m[1]}{value}", text)
        if count != 1:
            raise AssertionError(f"{name} stands {count} times in the data list")
    return text


def _replace(text: str, before: str, value: Any, after: str) -> str:
    pattern = re.compile(f'({re.escape(before)})[^<"]*({re.escape(after)})')
    text, count = pattern.subn(lambda m: f"{m[1]}{value}{m[2]}", text)
    if count != 1:
        raise AssertionError(f"{before} stands {count} times in the file")
    return text


def _reach(text: str, reach: tuple[float, ...]) -> str:
    """Correction limits of an RSI context before 4.1, and the monitor a little above them."""
    for axis, value in enumerate(reach, 1):
        for name, number in ((f"LowerLimA{axis}", -value), (f"UpperLimA{axis}", value), (f"MaxA{axis}", value + 1.0)):
            pattern = re.compile(rf'(name="{name}"[^>]*?value=")[^"]*(")', re.I)
            text, count = pattern.subn(
                lambda m, number=number: f"{m[1]}{number:g}{m[2]}",
                re.sub(rf'(Name="{name}" ParamID="\d+" ParamValue=")[^"]*(")', lambda m, number=number: f"{m[1]}{number:g}{m[2]}", text),
            )
            if count > 1:
                raise AssertionError(f"{name} stands {count} times in the context")
    return text
