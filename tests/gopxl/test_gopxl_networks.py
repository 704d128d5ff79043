"""Discovery between two computers: network namespaces joined by a cable, a sensor in one, whoever looks for it in the other."""

import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import contextmanager

import pytest
from mbcacq_gocator.gopxl.discovery import parse

SENSOR, COMPUTER = "10.77.1.10", "10.77.1.2"


def run(*command):
    subprocess.run(command, check=True, capture_output=True, timeout=900)


@pytest.fixture(scope="module")
def cable():
    """Names of two namespaces; the sensor's has no way but the cable, as a sensor has no gateway."""
    if sys.platform != "linux" or shutil.which("ip") is None:
        pytest.skip("network namespaces need Linux and iproute2")
    ours, theirs = (f"mbcacq-{end}-{os.getpid()}" for end in ("pc", "sensor"))
    try:
        run("ip", "netns", "add", ours)
    except subprocess.CalledProcessError:
        pytest.skip("no right to make network namespaces")
    try:
        run("ip", "netns", "add", theirs)
        run("ip", "-n", ours, "link", "add", "pc", "type", "veth", "peer", "name", "sensor", "netns", theirs)
        for space, end, address in ((ours, "pc", COMPUTER), (theirs, "sensor", SENSOR)):
            run("ip", "-n", space, "address", "add", f"{address}/24", "broadcast", "+", "dev", end)
            run("ip", "-n", space, "link", "set", end, "up")
            run("ip", "-n", space, "link", "set", "lo", "up")
        yield ours, theirs
    finally:
        for space in (ours, theirs):
            subprocess.run(["ip", "netns", "delete", space], capture_output=True, timeout=900)


@contextmanager
def sensor(space, module, *options):
    command = ["ip", "netns", "exec", space, sys.executable, "-m", f"mbcacq_fakes.protocols.{module}", "--pixels", "40", "50", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield json.loads(process.stdout.readline())
        finally:
            process.terminate()


def listed(space):
    command = ["ip", "netns", "exec", space, sys.executable, "-m", "mbcacq_gocator"]
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=900).stdout.splitlines()


@pytest.mark.parametrize("host", ["0.0.0.0", SENSOR])
def test_a_sensor_is_found_where_it_can_be_reached(cable, host):
    ours, theirs = cable
    with sensor(theirs, "gopxl", "--host", host):
        found = subprocess.run(["ip", "netns", "exec", ours, sys.executable, "-c", SCAN], capture_output=True, text=True, timeout=900)
        assert found.stdout.split() == ["3504", "True"], found.stderr


SCAN = """
from mbcacq_gocator.gopxl.driver import GoPxL
with GoPxL("s", "3504", {"serial": 12345, "timeout_s": 60}) as scanner:
    print(scanner.describe().model, len(scanner.capture().points) > 100)
"""


def test_both_generations_are_listed_at_once(cable):
    ours, theirs = cable
    with sensor(theirs, "gopxl", "--host", "0.0.0.0", "--serial", "67890"), sensor(theirs, "gocator", "--host", SENSOR, "--discovery"):
        new, classic = listed(ours)
    assert new == f"3504  serial 67890  GoPxL 1.5.12.3  at {SENSOR}, control 3600, data 3601"
    assert re.fullmatch(r"3210  serial 12345  firmware 6\..*  at 10\.77\.1\.10/24", classic)


def test_a_sensor_that_answers_in_both_ways_is_listed_once(cable):
    ours, theirs = cable
    with sensor(theirs, "gopxl", "--host", "0.0.0.0"), sensor(theirs, "gocator", "--host", SENSOR, "--discovery"):
        assert listed(ours) == [f"3504  serial 12345  GoPxL 1.5.12.3  at {SENSOR}, control 3600, data 3601"]


# The vendor's client asks from a port of its own, and listens on 3320, where it may not be alone.
VENDOR = """
import socket, sys
from mbcacq_gocator.gopxl.discovery import request
ears = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
for ear in ears:
    ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    ear.bind(("", 3320))
    ear.settimeout(20)
mouth = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
mouth.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
mouth.bind((sys.argv[1], 0))
mouth.sendto(request(), ("255.255.255.255" if len(sys.argv) < 3 else sys.argv[2], 3320))
for ear in ears:
    while (data := ear.recv(1600)) == request():
        pass
    print(data.hex())
"""


@pytest.mark.parametrize("same_computer", [False, True])
def test_every_program_that_listens_on_3320_hears_the_answer(cable, same_computer):
    ours, theirs = cable
    asker, address = (theirs, SENSOR) if same_computer else (ours, COMPUTER)
    with sensor(theirs, "gopxl", "--host", "0.0.0.0"):
        command = ["ip", "netns", "exec", asker, sys.executable, "-c", VENDOR, address, "10.77.1.255"]
        heard = subprocess.run(command, check=True, capture_output=True, text=True, timeout=900).stdout.split()
    assert [parse(bytes.fromhex(data), "").address for data in heard] == [SENSOR, SENSOR]


def test_a_sensor_on_loopback_answers_its_own_computer_only(cable):
    ours, theirs = cable
    with sensor(theirs, "gopxl"):
        assert listed(ours) == []
        assert any("at 127.0.0.1" in line for line in listed(theirs))
