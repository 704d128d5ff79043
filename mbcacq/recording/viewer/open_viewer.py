"""The rerun viewer on a recording, and pictures of it without a screen. On POSIX it runs in a process group of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rerun as rr
from rerun.experimental import ViewerClient

from mbcacq.devices import kill
from mbcacq.errors import ConfigError, MbcacqError, RecordingError, SystemRefused
from mbcacq.files.atomic_write import replacing, write_files
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.rrd import layout, rerun_program
from mbcacq.recording.rrd.blueprint import Enlarged, for_cell
from mbcacq.recording.rrd.library_reader import NOT_OURS
from mbcacq.recording.rrd.new_stream import into_file, new_stream, send_default_blueprint
from mbcacq.recording.rrd.quiet_environment import quiet_environment
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.rrd.rerun_path import rerun_path
from mbcacq.recording.rrd.scene import log_axes_key, log_texts
from mbcacq.recording.run_folder.latest import refuse_plan
from mbcacq.recording.viewer.vulkan import WITHOUT_VULKAN, has_vulkan

QUIETLY = ("--bind", "127.0.0.1", "--hide-welcome-screen")  # it would listen everywhere
START_TIMEOUT_S = 30.0
LOAD_TIMEOUT_S = 120.0
SETTLE_S, TAB_SETTLE_S = 7.0, 1.0  # until the viewer's notices have gone from the picture; until it turns to a tab
STILL_S, DRAWN_TIMEOUT_S = 1.0, 60.0  # a picture that stays the same for so long is complete: what still loads turns


def files(path: Path | str) -> list[Path]:
    """What the viewer opens for a run folder (its recordings, its result, its diagnosis) or for a .rrd file."""
    path = Path(path)
    if path.is_dir():
        found = layout.parts(path)
        if not found:
            raise ConfigError(f"{path} holds no recording (run.rrd); give the folder of a run, or a .rrd file")
        return found + [file for name in (layout.RESULT_FILE, layout.DIAGNOSIS_FILE) if (file := path / name).exists()]
    if not path.is_file():
        raise ConfigError(f"{path} does not exist; give the folder of a run, or a .rrd file")
    refuse_plan(path)
    if path.suffix not in (".rrd", ".rbl"):
        raise ConfigError(f"{path} is no recording; give the folder of a run, or a .rrd file")
    return [path]


def refuse_unreadable(path: Path) -> None:
    """Raises RecordingError for a file of which nothing can be read; a torn end is no hindrance, and the viewer shows those of others."""
    try:
        Recording(path)
    except RecordingError as error:
        if NOT_OURS not in str(error):
            raise


def view(sources: Sequence[Path | str], opening: Callable[[], None] = lambda: None) -> None:
    """Open files or addresses in the viewer and wait until it is closed. opening: called before. Raises SystemRefused where
    there is no screen or the viewer does not start, RecordingError for a file that is no recording."""
    for source in sources:
        if isinstance(source, Path) and source.suffix == ".rrd":
            refuse_unreadable(source)
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise SystemRefused("there is no screen to open the viewer on; make pictures with --screenshot DIR")
    opening()
    with quiet_environment() as environment, tempfile.TemporaryDirectory(prefix="mbcacq-view-") as folder:
        shown = map(str, layout_first(sources, Path(folder)))
        child = rerun_program.started([*QUIETLY, *shown], environment, subprocess.DEVNULL, subprocess.PIPE)
        try:
            _, err = child.communicate()
        except BaseException:
            kill(child)
            child.communicate()
            raise
    if child.returncode:
        reason = rerun_program.error_line(subprocess.CompletedProcess(child.args, child.returncode, "", err))
        raise SystemRefused(f"the viewer could not be opened ({reason}); without a screen, use --screenshot DIR")


def screenshots(
    sources: Sequence[Path | str],
    folder: Path,
    size: tuple[int, int] = (1600, 1000),
    pose: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> list[Path]:
    """Write a PNG of each tab at the end of a pose (number in the plan; default: the last) into a folder, made where it is missing. The
    pictures are one set: those of before stay where they cannot all be made.

    progress: gets a sentence a step. Raises SystemRefused if there is no Vulkan driver (a software one will do), ConfigError where
    there is no such pose.
    """
    progress("reading the recording")
    moment = _moment(sources, pose)
    pictures: dict[str, bytes] = {}
    progress("starting the viewer")
    with tempfile.TemporaryDirectory(prefix="mbcacq-view-") as made, _headless(size) as client:
        progress("loading the recording")
        _load(client, layout_first(sources, Path(made)))
        tabs = _tabs(client)
        for number, tab in enumerate(tabs, 1):
            progress(f"picture of {tab}: {number} of {len(tabs)}")
            _turn_to(client, tab)
            _go_to(client, tab, moment)
            time.sleep(TAB_SETTLE_S if pictures else SETTLE_S)
            pictures[f"{tab.lower()}.png"] = _picture(client, Path(made) / "picture.png")
    return write_files(Path(folder).absolute(), pictures)


def _picture(client: Any, path: Path) -> bytes:
    """The window as it looks once nothing in it changes any more. path: to which the viewer writes it."""
    path.unlink(missing_ok=True)
    deadline, before = time.monotonic() + DRAWN_TIMEOUT_S, b""
    while True:
        late = time.monotonic() > deadline
        try:
            client.save_screenshot(str(path))
        except TimeoutError:  # a busy viewer
            if late:
                raise
            continue
        if (now := path.read_bytes()) == before or late:
            return now
        before = now
        time.sleep(STILL_S)


def layout_first(sources: Sequence[Path | str], folder: Path) -> list[Path | str]:
    """The sources, and in front of them a small file in ``folder`` with today's blueprint, its camera and its magnifications. The viewer
    takes the blueprint of the first of several files of one recording. Sources that are no run of ours are left as they are."""
    try:
        first = Recording(sources[0])
        plan, cell_yaml = first.text(layout.PLAN), first.text(layout.CELL)
        cell = parse_cell(cell_yaml)
    except MbcacqError:
        return list(sources)
    path = folder / "layout.rrd"
    stream = new_stream(layout.APPLICATION, recording_id=first.recording_id, send_properties=False)
    with replacing(path) as partial, into_file(stream, partial):
        send_default_blueprint(stream, for_cell(cell, plan, enlarged(sources)))
        stream.log(layout.VIEW, rr.TextDocument("laid out by mbcacq view"), static=True)
        log_axes_key(stream, cell.robot.axes)  # an older recording has none,
        log_texts(stream, plan, cell_yaml)  # nor these
    return [path, *sources]


def _tabs(client: Any) -> list[str]:
    """Names of the tabs shown; a recording of another program has one picture."""
    contents, blueprint = _root(client)
    names = [blueprint[entity]["ContainerBlueprint"].get("display_name", "") for entity in contents if entity in blueprint]
    return names if contents and all(names) and len(names) == len(contents) else ["view"]


def _turn_to(client: Any, tab: str) -> None:
    contents, blueprint = _root(client)
    for entity in contents:
        if blueprint[entity].get("ContainerBlueprint", {}).get("display_name") == tab:
            root = blueprint[_root_entity(blueprint)]
            root["ContainerBlueprint"]["active_tab"] = entity
            client.set_blueprint(blueprint, "recording")


def _root(client: Any) -> tuple[list[str], dict[str, Any]]:
    """What the outermost container holds, where that is tabs of containers; and the whole blueprint."""
    blueprint = client.get_blueprint("recording").blueprint
    container = blueprint.get(_root_entity(blueprint), {}).get("ContainerBlueprint", {})
    contents = container.get("contents", []) if container.get("container_kind") == "Tabs" else []
    return [entity for entity in contents if entity.startswith("/container/")], blueprint


def _root_entity(blueprint: dict[str, Any]) -> str:
    return f"/container/{blueprint.get('/viewport', {}).get('ViewportBlueprint', {}).get('root_container')}"


def enlarged(sources: Sequence[Path | str]) -> Any:
    """What result and diagnosis among the sources hold to show (``blueprint.Enlarged``)."""
    found: dict[str, Any] = {}
    responses: tuple[str, ...] = ()
    for source in sources:
        if Path(source).name in (layout.RESULT_FILE, layout.DIAGNOSIS_FILE):
            for row in Recording(source).rows(layout.ENLARGED):
                shown = ("pose", "all", "diagnosis", "lengths", "compared", "investigated")
                found |= {name: float(row[name][0]) for name in shown if name in row}
                if isinstance(titles := row.get("responses"), list):
                    responses = tuple(titles)
    lengths, compared, investigated = bool(found.get("lengths")), bool(found.get("compared", True)), bool(found.get("investigated"))
    return Enlarged(found.get("pose"), found.get("all"), found.get("diagnosis"), lengths, responses, compared, investigated)


@contextmanager
def _headless(size: tuple[int, int]) -> Iterator[Any]:
    with quiet_environment() as environment, _client(size, environment) as client:
        yield client


@contextmanager
def _client(size: tuple[int, int], environment: dict[str, str]) -> Iterator[Any]:
    """A client of a viewer without a screen, which ends with the block. Errors of the viewer become a RecordingError, a computer
    that cannot draw is SystemRefused."""
    port = rerun_program.free_port()
    window = ("--headless", "--port", str(port), "--window-size", f"{size[0]}x{size[1]}")
    child = rerun_program.started([*window, *QUIETLY], environment, subprocess.DEVNULL, subprocess.DEVNULL)
    deadline = time.monotonic() + START_TIMEOUT_S
    try:
        while True:
            try:
                client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                client.get_state()
                break
            except Exception as error:  # noqa: BLE001 the client raises whatever its transport does while the viewer starts
                if child.poll() is not None or time.monotonic() > deadline:
                    raise SystemRefused(
                        f"no picture could be made: the viewer does not start without a screen; {WITHOUT_VULKAN}"
                    ) from error
                time.sleep(0.2)
        try:
            yield client
        except (RuntimeError, TimeoutError, ConnectionError) as error:
            ended = child.poll()
            why = str(error).splitlines()[0] if ended is None else f"the viewer ended by itself, code {ended}; is there too little memory?"
            if ended is not None and not has_vulkan():
                raise SystemRefused(f"no picture could be made: the viewer ended by itself, code {ended}; {WITHOUT_VULKAN}") from error
            raise RecordingError(f"no picture could be made ({why}); try again, or look with mbcacq view") from error
    finally:
        kill(child)
        child.wait()


def _load(client: Any, sources: Sequence[Path | str]) -> None:
    deadline = time.monotonic() + LOAD_TIMEOUT_S
    client.open([rerun_path(Path(source).absolute()) for source in sources])
    while client.get_state().loading and time.monotonic() < deadline:
        time.sleep(0.1)


def _go_to(client: Any, tab: str, moment: tuple[int, float] | None) -> None:
    """To the pose, on the timeline on which the tab is best read. Without a pose the time stands still: a film is no picture."""
    if moment is None:
        client.set_time(play_state="paused")
        return
    number, time_s = moment
    if tab in ("Cell", "Motion"):
        client.set_time(layout.TIME, duration=time_s, play_state="paused")
    else:
        client.set_time(layout.POSE, sequence=number, play_state="paused")


def _moment(sources: Sequence[Path | str], pose: int | None) -> tuple[int, float] | None:
    """Number of a pose and the run time (s) of its end. None: nothing was measured, as in a drawn plan or another program's recording."""
    own = [source for source in sources if Path(source).name not in (layout.RESULT_FILE, layout.DIAGNOSIS_FILE)]
    try:
        rows = [row for source in own for row in Recording(source).observed()]
    except RecordingError:
        if pose is None:
            return None
        raise ConfigError(f"{own[0]} holds no measured poses to choose from; leave --pose out") from None
    ends = {int(row["pose"][0]): float(row["time_s"][0]) for row in rows}
    if pose is not None and pose not in ends:
        raise ConfigError(f"pose {pose} is not in the recording, which has {len(ends)} (up to {max(ends, default=0)}); give another --pose")
    number = pose if pose is not None else max(ends, key=ends.__getitem__, default=None)
    return None if number is None else (number, ends[number])
