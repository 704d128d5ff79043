"""The recording in the viewer, where there is a Vulkan driver (a software one will do)."""

from __future__ import annotations

import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.recording.rrd import layout, rerun_program
from mbcacq.recording.viewer import open_viewer


@pytest.fixture(scope="module")
def vulkan():
    if not any(Path(folder).glob("*.json") for folder in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d") if Path(folder).is_dir()):
        pytest.skip("no Vulkan driver is installed (apt-get install mesa-vulkan-drivers)")


def headless() -> set[int]:
    """Programs without a window that this process has started; others may run beside."""
    return {each.pid for each in psutil.Process().children(recursive=True) if "--headless" in each.cmdline()}


def test_a_picture_without_a_screen_and_no_viewer_left_behind(a_run, tmp_path, vulkan, monkeypatch):
    monkeypatch.setattr(open_viewer, "SETTLE_S", 0.5)
    monkeypatch.setattr(open_viewer, "TAB_SETTLE_S", 0.5)
    monkeypatch.setattr(open_viewer, "STILL_S", 0.3)
    before = headless()
    pictures = open_viewer.screenshots(open_viewer.files(a_run), tmp_path / "pictures", (800, 600), pose=1)
    assert headless() <= before
    assert [p.name for p in pictures] == ["cell.png", "motion.png", "spheres.png", "calibration.png"]  # no tab of what was not made
    images = {p.read_bytes() for p in pictures}
    assert len(images) == 4  # each tab looks different
    for data in images:
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        width, height = struct.unpack(">II", data[16:24])
        assert width * 600 == height * 800
        assert len(data) > 20_000  # more than an empty window


def test_the_viewer_opens_the_recording_and_the_result_of_a_run(a_run, tmp_path):
    assert open_viewer.files(a_run) == [a_run / "run.rrd"]
    shutil.copy(a_run / "run.rrd", a_run / layout.RESULT_FILE)
    assert open_viewer.files(a_run) == [a_run / "run.rrd", a_run / layout.RESULT_FILE]
    with pytest.raises(ConfigError, match="holds no recording"):
        open_viewer.files(tmp_path)
    with pytest.raises(ConfigError, match="does not exist"):
        open_viewer.files(tmp_path / "absent.rrd")


def test_a_picture_of_a_pose_that_was_not_measured_is_refused(a_run, tmp_path):
    with pytest.raises(ConfigError, match="pose 99 is not in the recording"):
        open_viewer.screenshots(open_viewer.files(a_run), tmp_path, pose=99)


class StandIn:
    """A viewer that shows one picture."""

    def __init__(self):
        self.opened, self.play_state = [], "playing"

    def set_time(self, *, play_state):
        self.play_state = play_state

    def open(self, files):
        self.opened += files

    def get_state(self):
        return SimpleNamespace(loading=False)

    def get_blueprint(self, _):
        return SimpleNamespace(blueprint={})

    def save_screenshot(self, path):
        Path(path).write_bytes(b"picture")


def test_a_picture_of_a_drawn_plan_needs_no_measured_pose(tmp_path, monkeypatch):
    plan, drawn, viewer = Path(__file__).parents[2] / "plans" / "quick.yaml", tmp_path / "plan.rrd", StandIn()
    assert CliRunner().invoke(app, ["plan", "show", str(plan), "--rrd", str(drawn)]).exit_code == 0
    for name in ("SETTLE_S", "STILL_S"):
        monkeypatch.setattr(open_viewer, name, 0.0)
    monkeypatch.setattr(open_viewer, "_headless", lambda size: nullcontext(viewer))
    done = CliRunner().invoke(app, ["view", str(drawn), "--screenshot", str(tmp_path / "pictures")])
    assert done.exit_code == 0, done.stderr
    assert done.stdout.strip() == str(tmp_path / "pictures" / "view.png")
    assert (viewer.opened, viewer.play_state) == ([str(drawn)], "paused")
    done = CliRunner().invoke(app, ["view", str(drawn), "--screenshot", str(tmp_path / "pictures"), "--pose", "3"])
    assert done.exit_code == 2
    assert "holds no measured poses to choose from; leave --pose out" in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="the program is a POSIX shell script")
@pytest.mark.parametrize("does", ["sleep 60", "yes error"])
def test_a_program_that_hangs_or_talks_without_end_is_stopped(tmp_path, monkeypatch, does):
    fake = tmp_path / "rerun"
    fake.write_text(f"#!/bin/sh\n{does}\n")
    fake.chmod(0o755)
    monkeypatch.setenv("RERUN_CLI_PATH", str(fake))
    with pytest.raises(RecordingError, match="did not end within 0.5 s"):
        rerun_program.run(["rrd", "verify"], timeout_s=0.5)


@pytest.mark.skipif(sys.platform == "win32", reason="the program is a POSIX shell script")
def test_view_that_is_terminated_leaves_no_scratch_folder(a_run, tmp_path):
    """The viewer has made its own in the folder for temporary files, and does not remove it."""
    fake, ready, scratch = tmp_path / "rerun", tmp_path / "ready", tmp_path / "scratch"
    fake.write_text(f'#!/bin/sh\nmkdir "$TMPDIR/of-the-viewer" && touch {ready}\nexec sleep 600\n')
    fake.chmod(0o755)
    scratch.mkdir()
    environment = os.environ | {"RERUN_CLI_PATH": str(fake), "TMPDIR": str(scratch), "DISPLAY": ":99"}
    command = [Path(sys.executable).with_name("mbcacq"), "view", str(a_run)]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL) as viewing:
        while not ready.exists():
            assert viewing.poll() is None, viewing.stderr.read()
            time.sleep(0.05)
        assert list(scratch.iterdir()) != []
        viewing.send_signal(signal.SIGTERM)
        viewing.communicate()
    assert viewing.returncode != 0
    assert list(scratch.iterdir()) == []
