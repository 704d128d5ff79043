"""The rerun program is started so that it asks nobody, leaves no trace in the home folder, and ends with its command."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mbcacq.recording.rrd import rerun_program
from mbcacq.recording.rrd.quiet_environment import quiet_environment
from mbcacq.recording.viewer import open_viewer

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and shell scripts are POSIX's")
WATCHED = pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed: connect calls cannot be watched")


@pytest.fixture
def spying_program(tmp_path, monkeypatch):
    """A stand-in for the rerun program that writes its environment and its pid into files, and stays."""
    script = tmp_path / "spy"
    script.write_text(f'#!/bin/sh\nenv > {tmp_path}/env\ncp "$XDG_CONFIG_HOME/rerun/analytics.json" {tmp_path}\necho $$ > {tmp_path}/pid\n')
    script.chmod(0o755)
    monkeypatch.setenv("RERUN_CLI_PATH", str(script))
    return script


def environment_of(folder: Path) -> dict[str, str]:
    return dict(line.split("=", 1) for line in (folder / "env").read_text().splitlines() if "=" in line)


def until(condition):
    deadline = time.monotonic() + 600.0
    while not condition():
        assert time.monotonic() < deadline, "it never happened"
        time.sleep(0.02)


def test_the_environment_switches_analytics_off_outside_the_home_folder():
    with quiet_environment() as environment:
        settings = json.loads((Path(environment["XDG_CONFIG_HOME"]) / "rerun" / "analytics.json").read_text())
        assert settings["analytics_enabled"] is False
        assert Path(settings["data_dir_path"]).is_relative_to(environment["XDG_DATA_HOME"])
        assert not Path(environment["XDG_CONFIG_HOME"]).is_relative_to(Path.home())
        assert environment["HTTPS_PROXY"] == environment["https_proxy"] == "http://127.0.0.1:9"
        assert "127.0.0.1" in environment["NO_PROXY"]
    assert not Path(environment["XDG_CONFIG_HOME"]).exists()


@POSIX
@pytest.mark.parametrize("start", ["rrd command", "window"])
def test_whatever_starts_the_program_gives_it_this_environment(spying_program, tmp_path, a_run, start, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":99")
    if start == "window":
        open_viewer.view([a_run / "run.rrd"])
    else:
        rerun_program.run(["rrd", "verify", "x"])
    assert environment_of(tmp_path)["HTTPS_PROXY"] == "http://127.0.0.1:9"
    assert json.loads((tmp_path / "analytics.json").read_text())["analytics_enabled"] is False


def gone(process):
    """Whether it has ended, reaped by whoever inherited it or not yet."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


@POSIX
def test_the_viewer_ends_when_its_command_is_ended(spying_program, tmp_path, a_run):
    with spying_program.open("a") as script:
        script.write("exec sleep 600\n")
    command = [sys.executable, "-c", "from mbcacq.cli import main; main()", "view", str(a_run)]
    process = subprocess.Popen(command, env={**os.environ, "DISPLAY": ":99"}, stderr=subprocess.PIPE, text=True)
    until(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text().strip())
    viewer = int((tmp_path / "pid").read_text())
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=900)
    until(lambda: gone(viewer))
    assert process.returncode == 5
    assert errors.splitlines()[-1].startswith("mbcacq: the viewer was ended by SIGTERM")


START = """
import sys, time
from mbcacq.recording.rrd import rerun_program
from mbcacq.recording.viewer import open_viewer
rerun_program.run(["rrd", "stats", sys.argv[1]])
try:
    with open_viewer._headless((400, 300)):
        time.sleep(5)  # the update check comes with the first frames
except open_viewer.RecordingError:
    pass  # without a Vulkan driver it starts all the same, asks, and ends
"""


@WATCHED
def test_the_program_connects_to_this_computer_only(a_run, tmp_path):
    home, trace = tmp_path / "home", tmp_path / "trace"
    home.mkdir()
    command = ["strace", "-f", "-qq", "-s", "200", "-e", "trace=connect", "-o", trace, sys.executable, "-c", START, a_run / "run.rrd"]
    hidden = {"XDG_CONFIG_HOME", "XDG_DATA_HOME", "RERUN_CLI_PATH"}
    done = subprocess.run(
        command,
        env={**{k: v for k, v in os.environ.items() if k not in hidden}, "HOME": str(home), "XDG_CACHE_HOME": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=240,
    )
    if "ptrace" in done.stderr:
        pytest.skip("processes may not be traced here")
    assert done.returncode == 0, done.stderr
    calls = [line for line in trace.read_text().splitlines() if "AF_INET" in line]
    assert calls  # those to the viewer on this computer were seen
    elsewhere = [line for line in calls if "127.0.0.1" not in line and '"::1"' not in line]
    assert not elsewhere
    assert [path for path in home.rglob("*") if "rerun" in path.name or "analytics" in path.name] == []
