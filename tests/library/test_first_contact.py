"""A first contact with real devices: a protocol for the plan's drivers, and one file of what the devices said."""

import json

import pytest

from mbcacq.devices import available, load_driver
from mbcacq.doctor.evidence import evidence
from mbcacq.doctor.first_contact import protocol
from mbcacq.model import shipped
from mbcacq.plan import load
from mbcacq.recording.rrd.checked_lines import checked_line

PLAN = """\
robot:
  driver: ur_rtde
  options: {address: 192.168.0.10, port: 30004}   # of the controller
scanner:
  driver: gocator
  options:
    address: "scanner-7.example"
sensors:
  - {driver: serial, options: {port: /dev/ttyUSB3, baudrate: 9600}}
"""


@pytest.mark.parametrize("kind", ["robots", "scanners", "positioners", "sensors"])
def test_every_driver_of_ours_says_what_to_look_at(kind):
    for name, target in available(kind).items():
        if target.startswith("mbcacq_") and name != "simulated":
            assert load_driver(kind, name).first_contact, name


def test_the_protocol_has_the_steps_of_the_plan_s_drivers_in_order():
    text = protocol(load(shipped.folder() / "kuka.yaml"))
    order = [
        "T1",
        "robot alone (driver kuka-rsi)" if "driver kuka-rsi" in text else "robot alone (driver kuka_rsi)",
        "scanner alone",
        "--step",
        "--evidence",
    ]
    assert [text.index(word) for word in order] == sorted(text.index(word) for word in order)
    assert text.count("- [ ] ") == text.count("seen: ")
    assert "{plan}" not in text


def test_an_arm_that_is_followed_is_never_told_to_move():
    text = protocol(load(shipped.folder() / "opcua.yaml"))
    assert "--arm --step" not in text
    assert "nothing moves by itself" in text


@pytest.fixture
def run(tmp_path):
    lines = [
        {"time_s": 0.1, "event": "run_started", "name": "x", "started": "2026", "n_poses": 2, "versions": {"numpy": "2.4.1"}},
        {
            "time_s": 0.2,
            "event": "device",
            "role": "robot",
            "driver": "mbcacq_ur.driver:UrRtdeRobot",
            "model": "UR10e",
            "serial": "20215500123",
            "firmware": "5.15.0.0",
            "settings": {"payload": "2.3 kg"},
            "fields": ["q [rad]"],
        },
        {"time_s": 9.0, "event": "pose_done", "pose": 0},
    ]
    (tmp_path / "journal.jsonl").write_bytes(b"".join(map(checked_line, lines)))
    log = {
        "time": "t",
        "time_s": 1.0,
        "level": "error",
        "source": "mbcacq",
        "text": "robot at 192.168.0.10:30004 was lost, 20215500123 too",
    }
    (tmp_path / "log.jsonl").write_bytes(checked_line(log))
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    return tmp_path


def test_the_evidence_holds_what_the_devices_said(run):
    found = evidence(run)
    assert found["devices"][0]["firmware"] == "5.15.0.0"
    assert found["poses"][0]["pose"] == 0
    assert found["plan"] == PLAN


def test_anonymous_evidence_has_no_address_no_port_name_and_no_serial_number(run):
    text = json.dumps(evidence(run, anonymous=True))
    for secret in ("192.168.0.10", "scanner-7.example", "/dev/ttyUSB3", "20215500123"):
        assert secret not in text, secret
    for kept in ("5.15.0.0", "2.4.1", "30004", "9600", "UR10e", "of the controller"):
        assert kept in text, kept
