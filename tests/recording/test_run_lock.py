"""Two writers in one run folder: the second is refused by name, a killed one leaves no lock."""

import os
import signal
import subprocess
import sys

import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.errors import ExitCode, RecordingError
from mbcacq.recording import load_observations
from mbcacq.recording.run_folder.lock import write_lock

HOLDER = """
import sys
from mbcacq.recording.run_folder.lock import write_lock
with write_lock(sys.argv[1], "run"):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(a_run):
    """A process that holds the lock of the run folder until its standard input ends."""
    process = subprocess.Popen([sys.executable, "-c", HOLDER, a_run], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


@pytest.mark.parametrize("arguments", [["recover"], ["report"], ["run", "plans/quick.yaml", "--dry-run", "--resume"]])
def test_the_second_writer_gets_the_pid_of_the_first(a_run, holder, arguments, monkeypatch):
    monkeypatch.chdir(os.path.join(os.path.dirname(__file__), "..", ".."))
    before = sorted(path.name for path in a_run.iterdir())
    outcome = CliRunner().invoke(app, [*arguments, str(a_run)])
    assert isinstance(outcome.exception, SystemExit)
    assert outcome.exit_code == ExitCode.RECORDING_FAILED
    errors = [line for line in outcome.stderr.splitlines() if line.startswith("mbcacq: ")]
    assert len(errors) == 1
    assert f"process {holder.pid} (mbcacq run)" in errors[0]
    assert sorted(path.name for path in a_run.iterdir()) == before


def test_one_file_of_a_run_folder_is_not_recovered_while_it_is_written(a_run, holder):
    from mbcacq.recording.run_folder.recovery import recover

    with pytest.raises(RecordingError, match=str(holder.pid)):
        recover(a_run / "run.rrd")


def test_who_only_reads_is_not_hindered(a_run, holder):
    assert load_observations(a_run).n_poses == 4


def test_a_killed_writer_leaves_no_lock(a_run, holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (a_run / ".run.lock.json").exists()  # nobody cleaned up
    outcome = CliRunner().invoke(app, ["recover", str(a_run)])
    assert outcome.exit_code == 0, outcome.stderr


def test_the_lock_is_free_after_an_error(tmp_path):
    with pytest.raises(ZeroDivisionError), write_lock(tmp_path, "run"):
        1 / 0  # noqa: B018
    with write_lock(tmp_path, "run"):
        assert (tmp_path / ".run.lock.json").exists()
    assert not (tmp_path / ".run.lock.json").exists()


NOBODY = 65534


@pytest.fixture
def ordinary_user():
    """This process without the rights of the superuser, who writes everywhere."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(NOBODY)
    yield
    os.seteuid(user)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="needs users as POSIX has them")
def test_a_folder_that_cannot_be_written_to_needs_no_lock(tmp_path, request):
    tmp_path.chmod(0o500)
    request.getfixturevalue("ordinary_user")
    with pytest.raises(PermissionError):
        (tmp_path / "probe").touch()
    with write_lock(tmp_path, "report"):  # reading goes on, without a lock
        pass
    with pytest.raises(RecordingError, match="cannot be locked: .*; choose a folder on another disk"), write_lock("/dev/null", "report"):
        pass
