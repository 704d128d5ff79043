"""A line a thing, a cure with each that is not well, and an exit code."""

import json
import os
import socket

import pytest
from dry_runs import plan_file
from typed_command import mbcacq

from mbcacq.doctor import from_error
from mbcacq.errors import ConnectError


def lines(done):
    return {line["topic"]: line for line in json.loads(done.stdout)["lines"]}


def test_this_computer_alone():
    done = mbcacq("doctor", "--json")
    assert done.returncode == 0, done.stdout
    found = lines(done)
    assert {"python", "libraries", "disk", "cycle", "pictures", "drivers"} <= set(found)
    assert "rerun-sdk 0.41" in found["libraries"]["text"]
    assert all(line["cure"] for line in found.values() if line["level"] != "ok")


def devices(robot, **scanner):
    def change(plan):
        plan["robot"]["options"] = {"connect_timeout_s": 1.0, **robot}
        plan["scanner"]["options"] = {"address": "127.0.0.1", "control_port": 49978, **scanner}
        plan["sensors"] = [{"driver": "serial", "options": {"port": "/dev/ttyUSB7", "line": "(?P<air_C>.+)"}}]

    return change


def test_every_device_that_does_not_answer_has_a_line_and_a_cure(tmp_path):
    done = mbcacq("doctor", plan_file(tmp_path, devices({"bind": "127.0.0.1", "port": 49977})), "--json")
    assert done.returncode == 3
    found = lines(done)
    for topic, word in (("robot", "49977"), ("scanner", "49978"), ("sensor 1", "/dev/ttyUSB7")):
        assert found[topic]["level"] == "error"
        assert word in found[topic]["text"]
        assert found[topic]["cure"]
    assert found["positioner"]["level"] == "warning"  # nobody to ask, here; not a fault of the cell
    assert found["network"]["text"].startswith("127.0.0.1:49977 on lo")
    text = mbcacq("doctor", tmp_path / "plan.yaml").stdout
    assert "error    sensor 1: " in text
    assert "         -> check the port's name" in text


def test_a_real_robot_is_not_connected_unasked(tmp_path):
    """192.0.2.1 is nobody's: connecting would fail, so a line without an error shows that nothing was tried."""
    done = mbcacq("doctor", plan_file(tmp_path, devices({"bind": "192.0.2.1", "controller_ip": "192.0.2.2", "port": 49152})), "--json")
    found = lines(done)
    assert found["robot"]["level"] == "warning"
    assert "--arm" in found["robot"]["cure"]
    assert found["network"]["text"].startswith("192.0.2.1 is not an address of this computer, which has ")
    assert "127.0.0.1 on lo" in found["network"]["text"]
    assert "ip addr add 192.0.2.1/24" in found["network"]["cure"]


def test_a_port_that_is_taken(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        done = mbcacq("doctor", plan_file(tmp_path, devices({"bind": "127.0.0.1", "port": port})), "--json")
    found = lines(done)
    assert found["network"]["text"] == f"127.0.0.1:{port} is taken by another program"
    assert f":{port}" in found["robot"]["text"]


def test_a_driver_that_is_not_installed_and_a_plan_that_is_none(tmp_path):
    plan = plan_file(tmp_path, lambda p: p["positioner"].update(driver="acme_lift"))
    found = lines(mbcacq("doctor", plan, "--json"))
    assert "'acme_lift' among the positioners that is not installed" in found["driver acme_lift"]["text"]
    plan.write_text("format: mbcacq-plan/1\nname: x\n")
    assert mbcacq("doctor", plan).returncode == 2


@pytest.mark.parametrize(
    ("sentence", "text", "cure"),
    [
        ("it is off; switch it on", "it is off", "switch it on"),
        ("a; b; do c", "a; b", "do c"),
        ("it is off", "it is off", "mend what the sentence names"),
    ],
)
def test_a_sentence_is_split_into_what_and_what_to_do(sentence, text, cure):
    line = from_error("x", ConnectError(sentence))
    assert (line.text, line.cure) == (text, cure)


def test_no_colour_codes_where_none_are_wanted(monkeypatch):
    monkeypatch.setitem(os.environ, "NO_COLOR", "1")
    assert "\x1b" not in mbcacq("doctor").stdout


def test_the_libraries_that_it_looks_for_are_those_that_are_installed_with_it():
    import re
    import tomllib
    from pathlib import Path

    from mbcacq.doctor.computer import LIBRARIES

    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    installed = {re.split(r"[<>=;\[ ]", dependency)[0] for dependency in project["dependencies"]}
    assert set(LIBRARIES) <= installed


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="/dev/full is of Linux")
def test_a_full_disk_is_no_mistake_of_the_command():
    done = mbcacq("doctor", "--protocol", "plans/quick.yaml", "--out", "/dev/full")
    assert done.returncode == 6
    assert "/dev/full cannot be written: No space left on device" in done.stderr
