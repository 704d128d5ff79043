"""A viewer that is connected live and goes away, or stops reading, takes nothing from the recording."""

import os
import signal
import socket
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import synthetic
from mbcacq_fakes.cell.ports import free_port

from mbcacq.recording import load_observations
from mbcacq.recording.rrd import rerun_program
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.rrd.writer import Recorder


def port_of(url):
    return int(url.rsplit(":", 1)[1].split("/")[0])


def clients_of(port):
    """Established connections to a port of this computer (Linux)."""
    wanted = f"0100007F:{port:04X}"
    return sum(line.split()[1] == wanted and line.split()[3] == "01" for line in Path("/proc/net/tcp").read_text().splitlines()[1:])


def test_live_connections_that_break_off_or_stay_silent_take_nothing(tmp_path):
    with Recorder(tmp_path, live=True, port=0) as recorder:
        port, silent = port_of(recorder.live_url), []
        for number, event in enumerate(synthetic.run()):
            recorder(event)
            if number % 5 == 0:
                client = socket.create_connection(("127.0.0.1", port))
                client.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"[: 8 * (number % 4)])
                if number % 2:
                    silent.append(client)
                else:
                    client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")  # a reset, as from a program that died
                    client.close()
        for client in silent:
            client.close()
    assert Recording(tmp_path / "run.rrd").about()["exit_status"] == "success"
    plain = tmp_path / "plain"
    with Recorder(plain) as recorder:
        for event in synthetic.run():
            recorder(event)
    np.testing.assert_array_equal(load_observations(tmp_path).xyz, load_observations(plain).xyz)


@pytest.mark.skipif(
    not any(Path(folder).glob("*.json") for folder in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")),
    reason="no Vulkan driver is installed (apt-get install mesa-vulkan-drivers)",
)
@pytest.mark.skipif(not os.path.exists("/proc/net/tcp"), reason="asks Linux who is connected")
@pytest.mark.parametrize("number", ["SIGKILL", "SIGSTOP"], ids=["killed", "frozen"])
def test_a_live_viewer_that_dies_or_freezes_takes_nothing_from_the_recording(tmp_path, number):
    stream = list(synthetic.run())
    with Recorder(tmp_path, live=True, port=0) as recorder:
        port = port_of(recorder.live_url)
        own = free_port()
        viewer = subprocess.Popen(
            [rerun_program.program(), "--headless", "--bind", "127.0.0.1", "--port", str(own), "--hide-welcome-screen", recorder.live_url],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            deadline = time.monotonic() + 600.0
            while clients_of(port) == 0:
                assert time.monotonic() < deadline
                assert viewer.poll() is None
                time.sleep(0.05)
            for event in stream[: len(stream) // 3]:
                recorder(event)
            os.killpg(viewer.pid, signal.Signals[number])
            for event in stream[len(stream) // 3 :]:
                recorder(event)
        finally:
            os.killpg(viewer.pid, signal.SIGKILL)
            viewer.wait()
    assert Recording(tmp_path / "run.rrd").about()["exit_status"] == "success"
    assert load_observations(tmp_path).n_poses == len({e.pose for e in stream if type(e).__name__ == "PoseDone"})
