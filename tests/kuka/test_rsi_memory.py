"""The memory that the RSI driver shares with its cycle process is there when it is created, or a sentence says that it is not."""

import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from kuka_bench import LIMITS_DEG
from mbcacq_fakes.cell.ports import free_port
from mbcacq_kuka.rsi.driver import KukaRsi
from mbcacq_kuka.rsi.shared import RING_BYTES, Shared

from mbcacq.devices import SystemRefused

SHM = Path("/dev/shm")
pytestmark = pytest.mark.skipif(not SHM.is_dir(), reason="no shared memory as files here")

SEPARATE = """
mount -t tmpfs -o {} none /dev/shm || exit 77
exec "$0" -c '
from mbcacq_kuka.rsi.driver import KukaRsi
try:
    KukaRsi("arm", "", dict(limits_deg=[[-1, 1]] * 6, port=0)).connect()
except Exception as error:
    print(type(error).__name__, error)
'
"""


def test_the_ring_of_cycles_is_allocated_at_creation():
    shared = Shared.create()
    try:
        assert (SHM / shared.name).stat().st_blocks * 512 >= RING_BYTES
    finally:
        shared.close()


def test_a_program_that_ends_before_it_closed_the_memory_prints_nothing():
    """As after several Ctrl-C: the views of the memory are there until the end."""
    program = (
        "from mbcacq_kuka.rsi.shared import Shared; kept = Shared.create(); kept.forget(); view = memoryview(kept._buffer)[:8]; del kept"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_ring_that_cannot_be_allocated_is_said_and_leaves_nothing(monkeypatch):
    blocks = []

    def full(handle, *_):
        blocks.append(Path(os.readlink(f"/proc/self/fd/{handle}")))
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(SystemRefused, match=r"no shared memory for the RSI cycles \(No space left on device\); free some in /dev/shm"):
        KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": free_port()}).connect()
    assert len(blocks) == 1
    assert not blocks[0].exists()


def test_ctrl_c_while_the_ring_is_made_leaves_nothing(monkeypatch):
    blocks = []

    def interrupted(handle, *_):
        blocks.append(Path(os.readlink(f"/proc/self/fd/{handle}")))
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(os, "posix_fallocate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        KukaRsi("arm", "", {"limits_deg": LIMITS_DEG, "port": free_port()}).connect()
    assert len(blocks) == 1
    assert not blocks[0].exists()


@pytest.mark.parametrize(("mounted", "reason"), [("size=8m", "No space left on device"), ("ro", "Read-only file system")])
def test_a_full_or_read_only_dev_shm_ends_no_driver_by_sigbus(mounted, reason):
    if shutil.which("unshare") is None:
        pytest.skip("unshare is not installed: no /dev/shm of its own for the test")
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-c", SEPARATE.format(mounted), sys.executable], capture_output=True, text=True, timeout=120
    )
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("a mount of its own is not permitted here")
    assert done.returncode == 0, done
    assert done.stdout.startswith(f"SystemRefused robot 'arm': no shared memory for the RSI cycles ({reason})")
