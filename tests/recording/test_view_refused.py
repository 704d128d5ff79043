"""No screen and a broken recording are two things: each has its words and its exit code."""

import pytest
import rerun as rr
from click.testing import CliRunner

from mbcacq.cli.app import app


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
