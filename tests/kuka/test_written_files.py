"""``mbcacq controller-files``: the plan's numbers stand in the files, and the files are what the driver and the fake work with."""

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from defusedxml.ElementTree import fromstring
from mbcacq_fakes.protocols.krc.eki_config import read_config
from mbcacq_kuka.controller_flags import flags_in
from mbcacq_kuka.eki.driver import KukaEki
from mbcacq_kuka.rsi.driver import KukaRsi

from mbcacq.cli.app import app
from mbcacq.devices import ConfigError, load_driver

PLANS = Path(__file__).parents[2] / "plans"
LIMITS = [(-170.0, 170.0), (-190.0, 45.0), (-120.0, 156.0), (-185.0, 185.0), (-120.0, 120.0), (-350.0, 350.0)]
FACTS = {
    "plan": "a plan",
    "robot": "KR 10",
    "speed_share": 0.42,
    "tool_frame": (1.5, -2.25, 260.0, 90.0, -1.0, 179.5),
    "load_kg": 2.3,
    "load_centre_mm": (0.0, 1.0, 32.0),
}
EKI = {
    "address": "10.1.2.3",
    "port": 54605,
    "limits_deg": LIMITS,
    "speed_deg_s": [200.0] * 6,
    "tool": 7,
    "base": 2,
    "acceleration_percent": 35,
    "controller_silence_ms": 800,
    "state_ms": 36,
}


def number(text, name):
    return float(re.search(rf"^\s*(?:DECL .*? )?{re.escape(name)}=(\S+)$", text, re.M)[1])


def test_the_plans_numbers_stand_in_the_eki_files():
    files = KukaEki.controller_files("arm", "KR 10", EKI, FACTS)
    for system in ("kss", "iiqka"):
        data = files[f"{system}/Program/mbcacq_eki.dat"]
        assert [number(data, n) for n in ("mb_tool", "mb_base", "mb_max_vel", "mb_max_acc", "mb_silence", "mb_period")] == [
            7,
            2,
            42,
            35,
            800,
            36,
        ]
        for k, (low, high) in enumerate(LIMITS, 1):
            assert low - 0.0011 <= number(data, f"mb_low[{k}]") <= low
            assert high <= number(data, f"mb_high[{k}]") <= high + 0.0011
        assert read_config(files[f"{system}/EthernetKRL/mbcacq_eki.xml"]).port == 54605
    assert fromstring(files["kss/EthernetKRL/mbcacq_eki.xml"]).findtext("CONFIGURATION/INTERNAL/IP") == "10.1.2.3"
    kss, new = (files[f"{system}/Program/mbcacq_eki.src"].splitlines() for system in ("kss", "iiqka"))
    assert len(kss) - len(new) == 2  # the message interrupt, which iiQKA.OS2 does not have
    assert not any("IR_STOPM" in line or "FLAG[120]" in line for line in new)
    assert any("INTERRUPT DECL 21" in line for line in new)
    assert "TOOL_DATA[7]={X 1.5000,Y -2.2500,Z 260.0000,A 90.0000,B -1.0000,C 179.5000}" in files["tool_data.txt"]
    assert "LOAD_DATA[7]={M 2.300,CM {X 0.0,Y 1.0,Z 32.0," in files["tool_data.txt"]


def test_the_plans_numbers_stand_in_the_rsi_files():
    options = {
        "bind": "172.31.1.9",
        "controller_ip": "172.31.1.147",
        "port": 50001,
        "limits_deg": LIMITS,
        "cycle_ms": 12,
        "sen_type": "Mine",
        "correction": "AKorr",
        "stop_element": "Halt",
        "correction_limit_deg": [11, 12, 13, 14, 15, 16],
    }
    files = KukaRsi.controller_files("arm", "KR 10", options, FACTS)
    for name in (n for n in files if n.endswith("mbcacq_ethernet.xml")):
        root = fromstring(files[name])
        assert [root.findtext(f"CONFIG/{t}") for t in ("IP_NUMBER", "PORT", "SENTYPE")] == ["172.31.1.9", "50001", "Mine"]
        assert [e.get("TAG") for e in root.find("RECEIVE/ELEMENTS")] == ["Halt", *(f"AKorr.A{i}" for i in range(1, 7))]
    assert "RSI_ON(#ABSOLUTE,#IPO)" in files["kss85/Program/mbcacq_rsi.src"]
    assert "RSI_ON(#ABSOLUTE,#IPO)" in files["kss_older/Program/mbcacq_rsi.src"]
    for name in ("kss85/Program/mbcacq_rsi.dat", "iiqka/Program/mbcacq_rsi.dat"):
        assert number(files[name], "lim_low[2]") == pytest.approx(-190.0, abs=0.0011)
        assert number(files[name], "lim_high[6]") == pytest.approx(350.0, abs=0.0011)
    old = fromstring(files["kss_older/SensorInterface/mbcacq.rsi.xml"])
    values = {p.get("Name"): p.get("ParamValue") for p in old.iter("Parameter")}
    assert [values[f"UpperLimA{i}"] for i in range(1, 7)] == [str(10 + i) for i in range(1, 7)]
    assert [values[f"LowerLimA{i}"] for i in range(1, 7)] == [str(-10 - i) for i in range(1, 7)]
    assert [values[f"MaxA{i}"] for i in range(1, 7)] == [str(11 + i) for i in range(1, 7)]
    model = files["kss_older/SensorInterface/mbcacq.rsi"]
    assert [re.search(rf'name="{n}A{i}" value="([^"]*)"', model)[1] for i in range(1, 7) for n in ("UpperLim", "LowerLim", "Max")] == [
        values[f"{n}A{i}"] for i in range(1, 7) for n in ("UpperLim", "LowerLim", "Max")
    ]


def test_the_version_of_rsi_decides_which_folder_a_controller_takes():
    """RSI up to 4.0 reads .rsi contexts, newer ones .rsix, whatever the KSS: KSS 8.5.5 with RSI 4.0.6 fits no rule by KSS alone."""
    written = KukaRsi.controller_files("arm", "KR 10", {"limits_deg": LIMITS}, FACTS)
    endings = {folder: {name.rsplit(".")[-1] for name in written if name.startswith(f"{folder}/")} for folder in ("kss85", "kss_older")}
    assert "rsix" in endings["kss85"]
    assert "rsi" not in endings["kss85"]
    assert "rsi" in endings["kss_older"]
    assert "rsix" not in endings["kss_older"]
    guide = " ".join(written["README.txt"].split())
    assert "KSS 8.5.5 with RSI 4.0.6, say, takes kss_older" in guide
    assert "RSI 4.1 or newer, 5.x (KSS 8.5 and newer as a rule): folder kss85" in guide
    assert "RSI 3.x and 4.0 (KSS older than 8.5 as a rule): folder kss_older" in guide
    assert {name.split("/")[0] for name in written if "/" in name} <= set(re.findall(r"folder (\w+)", guide))


@pytest.mark.parametrize(
    ("driver", "change", "says"), [(KukaEki, {"address": "krc.local"}, "address in numbers"), (KukaEki, {"port": 7000}, "54600 to 54615")]
)
def test_what_a_controller_cannot_take_is_refused(driver, change, says):
    with pytest.raises(ConfigError, match=says):
        driver.controller_files("arm", "KR 10", {**EKI, **change}, FACTS)


def test_rsi_files_need_a_stop_element():
    with pytest.raises(ConfigError, match="stop_element"):
        KukaRsi.controller_files("arm", "", {"limits_deg": LIMITS, "stop_element": ""}, FACTS)


@pytest.mark.parametrize("plan", ["kuka.yaml", "kuka-eki.yaml"])
def test_the_command_writes_them_once(tmp_path, plan):
    out = tmp_path / "files"
    done = CliRunner().invoke(
        app, ["controller-files", str(PLANS / plan), "--out", str(out)], standalone_mode=False, catch_exceptions=False
    )
    assert done.exit_code == 0
    written = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    guide = written["README.txt"].decode("ascii")
    for name, data in written.items():
        assert data.isascii()
        assert data.count(b"\n") == data.count(b"\r\n") > 0
        stem = Path(name).stem
        assert name in ("README.txt",) or stem in guide or f"{name.split('/')[-2]}/*" in guide, name
    assert "KUKA KR 10 R1100-2" in guide
    with pytest.raises(ConfigError, match=r"exists already.*--replace"):
        CliRunner().invoke(app, ["controller-files", str(PLANS / plan), "--out", str(out)], standalone_mode=False, catch_exceptions=False)
    again = CliRunner().invoke(
        app,
        ["controller-files", str(PLANS / plan), "--out", str(out), "--replace", "--json"],
        standalone_mode=False,
        catch_exceptions=False,
    )
    assert "README.txt" in again.output


def test_the_flags_of_another_program_are_refused():
    for first in (104, 106, 110, 1):
        with pytest.raises(ConfigError, match=r"\$FLAG\[(105|110|1)\] belongs to"):
            KukaEki.controller_files("arm", "KR 10", {**EKI, "first_flag": first}, FACTS)


def test_other_flags_stand_in_all_files_together():
    plain, moved = (KukaEki.controller_files("arm", "KR 10", {**EKI, **more}, FACTS) for more in ({}, {"first_flag": 200}))
    used = [set().union(*(flags_in(text) for name, text in files.items() if "/" in name)) for files in (plain, moved)]
    assert used == [set(range(120, 125)), set(range(200, 205))]
    assert not used[0] & {105, 110}  # of KUKA's EKI server
    assert "$FLAG[200] to $FLAG[204]" in moved["README.txt"]
    for system in ("kss", "iiqka"):
        assert set(read_config(moved[f"{system}/EthernetKRL/mbcacq_eki.xml"]).flags.values()) == {201}


@pytest.mark.parametrize(
    ("driver", "options", "says"),
    [
        (KukaRsi, {"limits_deg": LIMITS}, "option bind is 127.0.0.1"),
        (KukaRsi, {"limits_deg": LIMITS, "bind": "0.0.0.0", "controller_ip": "172.31.1.147"}, "option bind is 0.0.0.0"),
        (KukaEki, {**EKI, "address": "127.0.0.1"}, "option address is 127.0.0.1"),
    ],
)
def test_an_address_that_no_controller_can_reach_is_warned_of(driver, options, says):
    files = driver.controller_files("arm", "KR 10", options, FACTS)
    assert says in files["WARNINGS.txt"]
    assert says in files["README.txt"]


def test_the_command_prints_the_warnings(tmp_path):
    done = CliRunner().invoke(app, ["controller-files", str(PLANS / "kuka.yaml"), "--out", str(tmp_path / "files")], standalone_mode=False)
    assert "warning: option bind is 127.0.0.1" in done.stderr


def test_files_for_a_real_address_come_without_a_warning():
    options = {"limits_deg": LIMITS, "bind": "172.31.1.9", "controller_ip": "172.31.1.147"}
    files = KukaRsi.controller_files("arm", "KR 10", options, FACTS)
    assert "WARNINGS.txt" not in files
    assert "WARNINGS" not in files["README.txt"]


def test_external_axes_are_sent_if_the_plan_asks_for_them():
    plain, more = (
        KukaRsi.controller_files("arm", "KR 10", {"limits_deg": LIMITS, "external_axes": wanted}, FACTS) for wanted in (False, True)
    )
    name = "kss85/SensorInterface/mbcacq_ethernet.xml"
    sent = [[e.get("TAG") for e in fromstring(files[name]).find("SEND/ELEMENTS")] for files in (plain, more)]
    assert set(sent[1]) - set(sent[0]) == {"DEF_EIPos", "DEF_MECur"}


@pytest.mark.parametrize("driver", [KukaRsi, KukaEki])
def test_the_guide_does_not_slow_the_arm_by_an_override_that_must_be_full(driver):
    guide = driver.controller_files("arm", "KR 10", EKI if driver is KukaEki else {"limits_deg": LIMITS}, FACTS)["README.txt"]
    assert "low override" not in guide.split("RANGE")[0].replace("a low override makes nothing slower", "")
    assert "`robot: speed`" in guide


def test_both_spellings_of_a_driver():
    assert load_driver("robots", "kuka-eki") is load_driver("robots", "kuka_eki") is KukaEki
    assert load_driver("robots", "kuka-rsi") is KukaRsi


def test_the_two_plans_differ_in_the_robots_connection_only():
    from mbcacq.plan import load

    rsi, eki = (load(PLANS / name) for name in ("kuka.yaml", "kuka-eki.yaml"))
    same = {"name": "", "robot": rsi.plan.robot.model_copy(update={"driver": "", "options": {}})}
    assert rsi.plan.model_copy(update=same) == eki.plan.model_copy(
        update={**same, "robot": eki.plan.robot.model_copy(update={"driver": "", "options": {}})}
    )
    np.testing.assert_array_equal(rsi.cell.robot.chain.rows, eki.cell.robot.chain.rows)
