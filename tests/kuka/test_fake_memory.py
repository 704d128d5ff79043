"""The shared memory of the fake controller is there when it is created, or a sentence says that it is not."""

import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.server import FakeEkiController, FakeKrc

from mbcacq.errors import SystemRefused

SHM = Path("/dev/shm")
pytestmark = pytest.mark.skipif(not SHM.is_dir(), reason="no shared memory as files here")

SEPARATE = """
mount -t tmpfs -o {} none /dev/shm || exit 77
exec "$0" -c '
from mbcacq_fakes.protocols.krc.server import FakeKrc
try:
    FakeKrc().start()
except Exception as error:
    print(type(error).__name__, error)
'
"""


def test_the_memory_is_allocated_at_creation():
    with ArmState.create() as state:
        file = SHM / state.name
        assert file.stat().st_blocks * 512 >= file.stat().st_size > 1 << 19


def test_memory_that_is_still_looked_at_when_the_program_ends_is_no_error():
    """An interrupted program closes nothing: its views live as long as the block."""
    made = "from mbcacq_fakes.protocols.krc.arm_state import ArmState; kept = ArmState.create()"
    program = f"{made}; kept.forget(); view = memoryview(kept._buffer)[:8]; del kept"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_what_cannot_be_allocated_is_said_and_leaves_nothing(monkeypatch):
    blocks = []

    def full(handle, *_):
        blocks.append(Path(os.readlink(f"/proc/self/fd/{handle}")))
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(SystemRefused, match=r"no \d+ KiB of shared memory \(No space left on device\); free some in /dev/shm"):
        ArmState.create()
    assert len(blocks) == 1
    assert not blocks[0].exists()


@pytest.mark.parametrize("fake", [FakeKrc, lambda: FakeEkiController(sources={}, channel="")], ids=["rsi", "eki"])
@pytest.mark.parametrize("moment", ["the memory is half made", "its process has not answered yet"])
def test_ctrl_c_while_a_controller_starts_leaves_nothing(fake, moment, monkeypatch):
    blocks, processes = [], []

    def allocate(handle, *_):
        blocks.append(Path(os.readlink(f"/proc/self/fd/{handle}")))
        if "memory" in moment:
            signal.raise_signal(signal.SIGINT)

    class Process(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            processes.append(self)
            assert os.getpgid(self.pid) != os.getpgrp()  # a terminal's Ctrl-C does not reach it
            monkeypatch.setattr(self.stdout, "readline", lambda: signal.raise_signal(signal.SIGINT))

    monkeypatch.setattr(os, "posix_fallocate", allocate)
    monkeypatch.setattr(subprocess, "Popen", Process)
    with pytest.raises(KeyboardInterrupt):
        fake().start()
    assert blocks
    assert not any(block.exists() for block in blocks)
    assert len(processes) == ("process" in moment)
    assert all(process.poll() is not None for process in processes)


@pytest.mark.parametrize(
    "module",
    ["mbcacq_fakes.protocols.krc.process", "mbcacq_fakes.protocols.krc.eki_process", "mbcacq_fakes.cell.process", "mbcacq_kuka.rsi.cycle"],
)
def test_a_process_whose_starter_was_interrupted_ends_without_a_word(module):
    done = subprocess.run([sys.executable, "-m", module], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=900)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize(("mounted", "reason"), [("size=32k", "No space left on device"), ("ro", "Read-only file system")])
def test_a_full_or_read_only_dev_shm_is_a_sentence_and_no_sigbus(mounted, reason):
    if shutil.which("unshare") is None:
        pytest.skip("unshare is not installed: no /dev/shm of its own for the test")
    command = ["unshare", "--mount", "sh", "-c", SEPARATE.format(mounted), sys.executable]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("a mount of its own is not permitted here")
    assert done.returncode == 0, done
    assert done.stdout.startswith("SystemRefused the fake controller has no ")
    assert f"of shared memory ({reason})" in done.stdout
