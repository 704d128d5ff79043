"""The rerun viewer on a recording, in a process group of its own; and pictures of it without a screen."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from mbcacq.errors import ConfigError, RecordingError
from mbcacq.recording import layout, rerun_program

SCREENSHOT_TIMEOUT_S = 180.0


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


def screenshot(sources: Sequence[Path | str], picture: Path, size: tuple[int, int] = (1600, 1000)) -> None:
    """Write a PNG of what the viewer shows. Needs a Vulkan driver, a software one will do. Raises RecordingError without."""
    picture = Path(picture).absolute()
    if not picture.parent.is_dir():
        raise ConfigError(f"{picture.parent} does not exist; create it or choose another place for the picture")
    picture.unlink(missing_ok=True)
    result = rerun_program.run([*map(str, sources), "--headless", "--port", "auto", "--hide-welcome-screen", "--window-size",
                                f"{size[0]}x{size[1]}", "--screenshot-to", str(picture)], SCREENSHOT_TIMEOUT_S)
    if result.returncode or not picture.exists():
        raise RecordingError(f"no picture could be made ({rerun_program.complaint(result)}); "
                             "a Vulkan driver is needed, e.g. apt-get install mesa-vulkan-drivers")
