"""No screen and a broken recording are two things: each has its words and its exit code."""

import subprocess
import sys
from pathlib import Path

import pytest
import rerun as rr
from click.testing import CliRunner

from mbcacq.cli.app import app

LAID_OUT = """
import resource, sys
from pathlib import Path
from mbcacq.recording.viewer.open_viewer import layout_first
resource.setrlimit(resource.RLIMIT_FSIZE, (50, resource.RLIM_INFINITY))
layout_first([Path(sys.argv[1])], Path(sys.argv[2]))
"""


@pytest.fixture(autouse=True)
def no_screen(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")


def test_without_a_screen_a_whole_recording_is_not_to_blame(tmp_path):
    path = tmp_path / "whole.rrd"
    stream = rr.RecordingStream("anybody")
    stream.save(path)
    stream.log("point", rr.Points3D([[0, 0, 0]]))
    stream.flush()
    stream.disconnect()
    done = CliRunner().invoke(app, ["view", str(path)])
    assert done.exit_code == 10
    assert "there is no screen" in done.stderr


def test_a_broken_recording_is_named_before_the_screen(tmp_path):
    path = tmp_path / "broken.rrd"
    path.write_bytes(b"RRF2" + bytes(60))
    done = CliRunner().invoke(app, ["view", str(path)])
    assert done.exit_code == 6
    assert "broken.rrd" in done.stderr
    assert "screen" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="limits of file sizes are of POSIX")
def test_no_room_for_the_layout_is_named(tmp_path):
    """The limit stands for a full temporary folder; the library's own writer waits for ever there."""
    recording = Path(__file__).with_name("three_poses.rrd")
    done = subprocess.run([sys.executable, "-c", LAID_OUT, recording, tmp_path], capture_output=True, text=True, timeout=900, check=False)
    assert "RecordingError" in done.stderr
    assert "layout.rrd cannot be written" in done.stderr
