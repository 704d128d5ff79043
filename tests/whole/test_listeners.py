"""Nothing in the tool listens on any address but loopback unless the plan says so."""

import os
import socket
import subprocess
import sys
import time

import pytest
from dry_runs import plan_file
from listeners import bound
from mbcacq_fakes.cell.ports import free_port
from typed_command import MBCACQ, ROOT

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="asks Linux which sockets are bound")

BUS = [
    {"driver": "modbus", "options": {"host": "127.0.0.1", "port": 5020, "values": {"robot_C": {"address": 0}}}},
    {"driver": "serial", "options": {"port": "socket://127.0.0.1:5021", "line": "T=(?P<air_C>[0-9.]+)"}},
]


def watched(*arguments, until, within_s=900):
    """Everything bound at any moment until the condition holds."""
    process = subprocess.Popen([MBCACQ, *map(str, arguments)], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    found, deadline = set(), time.monotonic() + within_s
    try:
        while not until(found) and process.poll() is None and time.monotonic() < deadline:
            found |= bound(process.pid)
            time.sleep(0.05)
    finally:
        process.terminate()
        text = process.communicate()[1]
    assert until(found), text
    return found


def test_a_live_dry_run_with_every_kind_of_device(tmp_path):
    journal = tmp_path / "run" / "journal.jsonl"
    plan = plan_file(tmp_path, lambda p: p.update(sensors=BUS))
    found = watched(
        "run",
        plan,
        "--dry-run",
        "--live",
        "--out",
        tmp_path / "run",
        until=lambda _: journal.exists() and journal.read_text().count("pose_done") >= 1,
    )
    assert {protocol for protocol, _, _ in found} >= {"tcp", "udp"}
    assert len(found) >= 6  # viewer, controller and driver, scanner's three, Modbus
    assert not [each for each in found if not each[1].is_loopback]


def test_a_fake_cell_in_the_foreground(tmp_path):
    robot, control, health, data = (free_port() for _ in range(4))

    def change(plan):
        plan["robot"]["options"] = {"bind": "127.0.0.1", "port": robot}
        plan["scanner"]["options"] = {"address": "127.0.0.1", "control_port": control, "health_port": health, "data_port": data}

    found = watched("fakes", plan_file(tmp_path, change), until=lambda f: {control, health, data} <= {port for _, _, port in f})
    assert not [each for each in found if not each[1].is_loopback]


def test_the_check_itself_sees_a_listener_on_every_address():
    with socket.create_server(("", 0)) as everywhere:
        assert ("tcp", 0, everywhere.getsockname()[1]) in {(p, int(a), port) for p, a, port in bound(os.getpid())}
