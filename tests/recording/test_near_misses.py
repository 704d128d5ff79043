"""What is almost right is answered with what was meant; what cannot help is not proposed."""

import subprocess
import sys

import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.cli.next_step import on_failure, say_after_failure
from mbcacq.errors import SystemRefused
from mbcacq.recording.viewer import open_viewer


def said(*words):
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2, done.output
    return done.stderr


def test_a_robot_and_a_command_that_are_called_almost_so_are_named(tmp_path):
    new = ("plan", "new", "--scanner", "gocator_2490", "--artefact", "eight_ball", "--out", str(tmp_path / "p.yaml"))
    assert "did you mean kr10_r1100_2 or kr10_r1100_sixx?" in said(*new, "--robot", "kr10_r1100")
    assert "there is no command 'calibrat'; did you mean calibrate?" in said("calibrat")


def test_a_path_is_a_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "there is no file ./kuka; the plan that came with mbcacq is kuka, without './'" in said("run", "./kuka", "--dry-run")


def test_a_file_that_never_was_a_recording_is_not_to_be_recovered(tmp_path):
    file = tmp_path / "notes.rrd"
    file.write_text("hello")
    done = CliRunner().invoke(app, ["calibrate", str(file)])
    assert "notes.rrd is no recording" in done.stderr
    assert "recover" not in done.stderr
    file.write_bytes(b"RRF2 torn")
    assert "mbcacq recover" in CliRunner().invoke(app, ["calibrate", str(file)]).stderr


def test_a_run_that_never_began_is_not_to_be_resumed(tmp_path, capsys):
    recording = tmp_path / "run.rrd"
    on_failure("go on where it ended", "mbcacq run --resume x", recording)
    say_after_failure()
    assert capsys.readouterr().err == ""
    recording.touch()
    on_failure("go on where it ended", "mbcacq run --resume x", recording)
    say_after_failure()
    assert "next: go on where it ended" in capsys.readouterr().err


def test_pictures_without_a_driver_name_the_package(monkeypatch):
    class Client:
        @staticmethod
        def connect(address):
            return Client()

        def get_state(self):
            return None

    ended = subprocess.Popen([sys.executable, "-c", "raise SystemExit(102)"])
    ended.wait()
    monkeypatch.setattr(open_viewer, "ViewerClient", Client)
    monkeypatch.setattr(open_viewer.rerun_program, "started", lambda *_: ended)
    monkeypatch.setattr(open_viewer, "kill", lambda child: None)
    monkeypatch.setattr(open_viewer, "has_vulkan", lambda: False)
    with pytest.raises(SystemRefused, match="code 102; it needs a Vulkan driver.*mesa-vulkan-drivers"), open_viewer._client((9, 9), {}):
        raise RuntimeError("the connection was closed")
