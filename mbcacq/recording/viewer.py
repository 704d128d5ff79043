"""The rerun viewer on a recording, in a process group of its own; and pictures of it without a screen."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.recording import layout, rerun_program

SCREENSHOT_TIMEOUT_S = 120.0
SETTLE_S = 7.0   # until the viewer's notices have gone from the picture


def files(path: Path | str) -> list[Path]:
    """What the viewer opens for a run folder (its recordings and its result) or for a .rrd file."""
    path = Path(path)
    if path.is_dir():
        found = layout.parts(path) + [file for file in (path / layout.RESULT_FILE,) if file.exists()]
        if not found:
            raise ConfigError(f"{path} holds no recording (run.rrd); give the folder of a run, or a .rrd file")
        return found
    if not path.is_file():
        raise ConfigError(f"{path} does not exist; give the folder of a run, or a .rrd file")
    return [path]


def view(sources: Sequence[Path | str]) -> None:
    """Open files or addresses in the viewer and wait until it is closed. Raises RecordingError if it cannot start."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise RecordingError("there is no screen to open the viewer on; make a picture with --screenshot FILE")
    child = subprocess.Popen([rerun_program.program(), "--hide-welcome-screen", *map(str, sources)], stdin=subprocess.DEVNULL,
                             stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace", start_new_session=True)
    try:
        _, err = child.communicate()
    except BaseException:
        rerun_program.end(child)
        child.communicate()
        raise
    if child.returncode:
        reason = rerun_program.complaint(subprocess.CompletedProcess(child.args, child.returncode, "", err))
        raise RecordingError(f"the viewer could not be opened ({reason}); without a screen, use --screenshot FILE")


def screenshot(sources: Sequence[Path | str], picture: Path, size: tuple[int, int] = (1600, 1000), pose: int | None = None) -> None:
    """Write a PNG of the viewer at the end of a pose (number in the plan; default: the last).

    Raises RecordingError where there is no Vulkan driver (a software one will do), ConfigError where there is no such pose.
    """
    picture = Path(picture).absolute()
    if not picture.parent.is_dir():
        raise ConfigError(f"{picture.parent} does not exist; create it or choose another place for the picture")
    moment = _moment(sources, pose)
    picture.unlink(missing_ok=True)
    port = _free_port()
    child = subprocess.Popen(
        [rerun_program.program(), "--headless", "--port", str(port), "--bind", "127.0.0.1", "--hide-welcome-screen", "--window-size",
         f"{size[0]}x{size[1]}"], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        _take(child, port, sources, moment, picture)
    finally:
        rerun_program.end(child)
        child.wait()


def _take(child: subprocess.Popen, port: int, sources: Sequence[Path | str], moment: float | None, picture: Path) -> None:
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + SCREENSHOT_TIMEOUT_S
    while True:
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
            break
        except Exception as error:  # noqa: BLE001 the client raises whatever its transport does while the viewer starts
            if child.poll() is not None or time.monotonic() > deadline:
                raise RecordingError("no picture could be made: the viewer does not start without a screen; "
                                     "it needs a Vulkan driver, e.g. apt-get install mesa-vulkan-drivers") from error
            time.sleep(0.2)
    try:
        for source in sources:
            client.open(str(Path(source).absolute()))
        while client.get_state().loading and time.monotonic() < deadline:
            time.sleep(0.2)
        if moment is not None:
            client.set_time(layout.TIME, duration=moment, play_state="paused")
        time.sleep(SETTLE_S)
        client.save_screenshot(str(picture))
    except RuntimeError as error:
        raise RecordingError(f"no picture could be made ({str(error).splitlines()[0]}); try again, or look with mbcacq view") from error


def _moment(sources: Sequence[Path | str], pose: int | None) -> float | None:
    """Run time (s) of the end of a pose."""
    from mbcacq.recording.reader import Recording

    rows = [row for source in sources if Path(source).name != layout.RESULT_FILE for row in Recording(source).observed()]
    ends = {int(row["pose"][0]): float(row["time_s"][0]) for row in rows}
    if pose is not None and pose not in ends:
        raise ConfigError(f"pose {pose} is not in the recording, which has {len(ends)} (up to {max(ends, default=0)}); give another --pose")
    return ends[pose] if pose is not None else max(ends.values(), default=None)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
