"""Other people's software at our fake, and our driver at other people's simulators."""

import json
import re
import socket
import subprocess
import sys
import threading
from importlib.util import find_spec

import numpy as np
import pytest
from kuka_bench import LIMITS_DEG, arrive, motion_limits, wait
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.krc.server import FakeKrc
from mbcacq_kuka.rsi.driver import KukaRsi

needs_rsipi = pytest.mark.skipif(find_spec("RSIPI") is None, reason="RSIPI is not installed (pip install rsipi)")

CONFIG = """<ROOT><CONFIG><IP_NUMBER>127.0.0.1</IP_NUMBER><PORT>{port}</PORT><SENTYPE>ImFree</SENTYPE><ONLYSEND>FALSE</ONLYSEND></CONFIG>
<SEND><ELEMENTS>
<ELEMENT TAG="DEF_RIst" TYPE="DOUBLE" INDX="INTERNAL"/><ELEMENT TAG="DEF_RSol" TYPE="DOUBLE" INDX="INTERNAL"/>
<ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL"/><ELEMENT TAG="DEF_ASPos" TYPE="DOUBLE" INDX="INTERNAL"/>
<ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/><ELEMENT TAG="DiL" TYPE="LONG" INDX="1"/><ELEMENT TAG="Digout.o1" TYPE="BOOL" INDX="2"/>
</ELEMENTS></SEND>
<RECEIVE><ELEMENTS>
<ELEMENT TAG="DEF_EStr" TYPE="STRING" INDX="INTERNAL"/>
<ELEMENT TAG="AKorr.A1" TYPE="DOUBLE" INDX="1" HOLDON="1"/><ELEMENT TAG="AKorr.A2" TYPE="DOUBLE" INDX="2" HOLDON="1"/>
<ELEMENT TAG="AKorr.A3" TYPE="DOUBLE" INDX="3" HOLDON="1"/><ELEMENT TAG="AKorr.A4" TYPE="DOUBLE" INDX="4" HOLDON="1"/>
<ELEMENT TAG="AKorr.A5" TYPE="DOUBLE" INDX="5" HOLDON="1"/><ELEMENT TAG="AKorr.A6" TYPE="DOUBLE" INDX="6" HOLDON="1"/>
</ELEMENTS></RECEIVE></ROOT>
"""

RSIPI_CLIENT = """
import json, sys, time
from RSIPI import RSIAPI
if __name__ == "__main__":
    api = RSIAPI(sys.argv[1], rsi_mode="absolute")
    api.start()
    assert api.wait_for_connection(20.0)
    for i in range(51):
        api.motion.update_joints(A1=0.02 * i, A6=-0.02 * i)
        time.sleep(0.008)
    deadline = time.monotonic() + 600.0
    while abs(api.motion.get_current_joints()["A1"] - 11.0) > 1e-4 and time.monotonic() < deadline:
        time.sleep(0.01)
    print(json.dumps(api.motion.get_current_joints()), flush=True)
    api.stop()
"""

RSIPI_SERVER = """
import sys
from RSIPI.rsi_echo_server import EchoServer
server = EchoServer(sys.argv[1], delay_ms=4, mode="absolute", timeout_packets=10000)
server.start()
print("up", flush=True)
sys.stdin.read()
server.stop()
"""


@needs_rsipi
def test_rsipi_moves_our_fake(tmp_path):
    port = free_port()
    (tmp_path / "config.xml").write_text(CONFIG.format(port=port))
    (tmp_path / "client.py").write_text(RSIPI_CLIENT)
    with FakeKrc(
        client=("127.0.0.1", port),
        layout=("RIst", "RSol", "AIPos", "ASPos", "Delay"),
        correction="AKorr",
        timeout=100000,
        start_deg=(10.0, -90.0, 90.0, 0.0, 0.0, 5.0),
        limits_deg=LIMITS_DEG,
    ) as krc:
        done = subprocess.run([sys.executable, "client.py", "config.xml"], cwd=tmp_path, capture_output=True, text=True, timeout=900)
        counters = krc.report()
        assert done.returncode == 0, done.stderr
        seen = json.loads([line for line in done.stdout.splitlines() if line.startswith("{")][-1])
    assert seen == pytest.approx({"A1": 11.0, "A2": -90.0, "A3": 90.0, "A4": 0.0, "A5": 0.0, "A6": 4.0}, abs=1e-3)
    assert counters["answers"] > 50
    assert counters["rejected"] <= counters["answers"] // 10


@needs_rsipi
def test_our_driver_moves_the_rsipi_server(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", 50000))
        except OSError:
            pytest.skip("UDP port 50000, which RSIPI's server always takes, is in use")
    port = free_port()
    (tmp_path / "config.xml").write_text(CONFIG.format(port=port))
    server = subprocess.Popen(
        [sys.executable, "-c", RSIPI_SERVER, "config.xml"],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert wait(server.stdout.readline)
        options = {"limits_deg": LIMITS_DEG, "port": port, "correction": "AKorr", "stop_element": "", "late_limit": 10000}
        with KukaRsi("arm", "", options) as robot:
            target = np.radians([3.0, -2.0, 4.0, 1.0, -1.0, 6.0])
            robot.move_to(target, motion_limits())
            np.testing.assert_allclose(arrive(robot).q, target, atol=2e-4)
            columns = robot.cycles().columns
            assert columns["ipoc"][0] >= 123456
            assert {"DiL", "Digout", "RIst", "RSol"} <= set(columns)
    finally:
        server.communicate(timeout=900)


class CountingSimulator(threading.Thread):
    """As the Python simulators of KUKA and ROS-Industrial do it: TYPE, one IPOC a telegram from 0 on, corrections followed at once."""

    def __init__(self, port):
        super().__init__()
        self.port, self.ended, self.answers = port, threading.Event(), []
        self.start_deg = [0.0, -90.0, 90.0, 0.0, 0.0, 0.0]

    def run(self):
        axes, ipoc = list(self.start_deg), 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.settimeout(0.02)
            while not self.ended.is_set():
                attributes = " ".join(f'A{i + 1}="{v}"' for i, v in enumerate(axes))
                sock.sendto(
                    (
                        f'<Rob TYPE="KUKA"><RIst X="0.0" Y="0.0" Z="0.0" A="0.0" B="0.0" C="0.0" /><AIPos {attributes} />'
                        f'<EIPos E1="0.0" E2="0.0" E3="0.0" E4="0.0" E5="0.0" E6="0.0" /><Delay D="0" /><IPOC>{ipoc}</IPOC></Rob>'
                    ).encode(),
                    ("127.0.0.1", self.port),
                )
                try:
                    answer = sock.recv(1024)
                except TimeoutError:
                    continue
                self.answers.append((ipoc, answer))
                correction = [float(v) for v in re.findall(rb'A\d="([^"]+)"', answer)]
                axes = [s + c for s, c in zip(self.start_deg, correction, strict=True)]
                ipoc += 1


def test_simulators_that_count_telegrams():
    port = free_port()
    simulator = CountingSimulator(port)
    simulator.start()
    try:
        with KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": port, "sen_type": "KROSHU"}) as robot:
            target = np.radians([10.0, -80.0, 85.0, 1.0, 2.0, 3.0])
            robot.move_to(target, motion_limits(settle_s=0.1))
            np.testing.assert_allclose(arrive(robot).q, target, atol=1e-6)
            columns = robot.cycles().columns
            assert set(np.diff(columns["ipoc"])) == {1.0}
            np.testing.assert_allclose(np.diff(columns["time_s"]), 0.004, atol=1e-9)
    finally:
        simulator.ended.set()
        simulator.join()
    ipoc, answer = simulator.answers[0]
    assert answer == (
        b'<Sen Type="KROSHU"><Stop>0</Stop><AK A1="0.000000" A2="0.000000" A3="0.000000" A4="0.000000" A5="0.000000" A6="0.000000"/>'
        b"<IPOC>0</IPOC></Sen>"
    )
    assert all(b"<IPOC>%d</IPOC>" % ipoc in answer for ipoc, answer in simulator.answers)
