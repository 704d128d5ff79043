"""Atomic writes: after a full disk, a kill or a power cut a file is the old one or the new one, whole.

The content goes to a temporary file in the same folder and is brought to the disk before it takes the name; then the folder is. No file
is written through a link that leads out of the folder in which it stands: a folder may come from somebody else.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from mbcacq.errors import RecordingError

PART = ".part"
ABANDONED_S = 3600.0  # a temporary file of a process that was killed; none is written for so long
INCOMPLETE = "INCOMPLETE.txt"
_SAYS = "These files were being replaced as a set when the program was stopped; any mbcacq command on this folder completes it."
_NAME_BYTES = 200  # of a temporary name; file systems allow 255
Content = bytes | str | Callable[[Path], object]  # of a file; a function writes it to a path
_NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)  # what cannot be synchronised, such as some network folders


def write_file(path: Path | str, data: bytes | str, *, folder: Path | None = None) -> Path:
    """Write a whole file; an existing one is replaced only when the new one is on the disk.

    Parameters
    ----------
    path
        Missing folders are made. A link stays a link, and what it leads to is replaced. A pipe or device is written to as it is.
    data
        Text is written as UTF-8, without a change of line ends.
    folder
        Links may lead anywhere in it; default: the folder of ``path``.

    Returns
    -------
    The path.

    Raises
    ------
    RecordingError
        The file cannot be written, or is a link that leads out of the folder; an existing one is as it was.
    """
    content = data.encode("utf-8", errors="surrogateescape") if isinstance(data, str) else data
    with replacing(path, folder=folder) as partial:
        partial.write_bytes(content)
    return Path(path)


def inside_folder(path: Path | str, folder: Path | None = None) -> Path:
    """The file that a path leads to through links, which may lead anywhere in a folder (default: that of the path) and nowhere else.

    Code that opens a file for writing by itself asks here first. Names of the system (/dev/stdout) are followed.

    Raises
    ------
    RecordingError
        A link leads out of the folder.
    """
    target, home = Path(os.path.realpath(path)), Path(os.path.realpath(Path(path).parent if folder is None else folder))
    of_system = Path(path).absolute().parts[1:2] in (("dev",), ("proc",))
    if not (target.is_relative_to(home) or of_system):
        raise RecordingError(f"{path} is a link to {target}, outside its folder, and is not written through; remove the link")
    return target


def own_file(path: Path | str) -> Path:
    """``inside_folder`` for a file that is appended to: one with a further name (a hard link) becomes a copy; the other would grow."""
    target = inside_folder(path)
    if target.is_file() and target.stat().st_nlink > 1:
        write_file(target, target.read_bytes())
    return target


def fresh(path: Path) -> Path:
    """The path of a temporary file of ours; what stands there, of a killed process or a link in a folder from somebody else, is removed."""
    _remove(path)
    return inside_folder(path)


@contextmanager
def replacing(path: Path | str, *, folder: Path | None = None) -> Iterator[Path]:
    """A temporary path beside ``path`` for a library that writes files itself; what stands there at the end of the block takes the name.

    Raises
    ------
    RecordingError
        The temporary file cannot be written or renamed, an OSError left the block, or a link leads out of the folder (see ``write_file``);
        an existing file is as it was.
    """
    path = Path(path)
    try:
        target = _target(path, folder)
        if target.exists() and not target.is_file():
            yield target  # a pipe, a terminal, a device: nothing that could be replaced
            return
        finish_set(target.parent)
        partial = _partial(target)
        try:
            yield partial
            publish(partial, target)
        finally:
            _remove(partial)
    except RecordingError:
        raise
    except OSError as error:
        raise _unwritable(path, error) from error


def write_files(
    folder: Path | str, files: Mapping[str, Content], *, on_disk: Callable[[str, Path], object] = lambda name, partial: None
) -> list[Path]:
    """Write several files of one folder as a set.

    A folder that is new appears with all of them. In one that is there, all are on the disk before the first takes its name, and a file
    INCOMPLETE.txt lists them while they do. ``finish_set`` completes an interrupted set, so it is never half the old one.

    Parameters
    ----------
    files
        Name to content; text is written as UTF-8. A function gets a temporary path and writes the file itself.
    on_disk
        Called for each with its name and temporary path, when its content is on the disk and none of them has taken its name.

    Returns
    -------
    The paths, in the order of ``files``.

    Raises
    ------
    RecordingError
        One of them cannot be written; the files of the folder are as they were.
    """
    folder = Path(folder)
    try:
        if folder.exists():
            _replace_set(folder, files, on_disk)
        else:
            _new_folder(folder, files, on_disk)
    except RecordingError:
        raise
    except OSError as error:
        raise _unwritable(folder, error) from error
    return [folder / name for name in files]


def publish(partial: Path, path: Path) -> None:
    """Bring a file to the disk and let it take the name of another in its folder. Raises OSError."""
    _prepare(partial, path)
    os.replace(partial, path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk. Windows does so by itself and has no handle of a folder to ask with; where the system
    refuses, the names come a little later."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def finish_set(folder: Path | str) -> None:
    """Complete a set of files that was stopped while its files took their names. Code that reads a folder of sets calls it first.

    All of them are on the disk then: the set is the new one from the moment that INCOMPLETE.txt lists it. Raises RecordingError.
    """
    folder = Path(folder)
    note = folder / INCOMPLETE
    try:
        lines = note.read_text(encoding="utf-8").splitlines()[1:] if note.is_file() else []
    except OSError as error:
        raise RecordingError(f"{note} cannot be read: {error.strerror or error}; look at the disk and its rights") from error
    try:
        pairs = [_pair(folder, line) for line in lines]
    except (ValueError, TypeError, KeyError):
        return  # of an earlier version, or of somebody else
    if pairs:
        try:
            _rename_set(folder, pairs)
        except OSError as error:
            raise _unwritable(folder, error) from error


def _pair(folder: Path, line: str) -> tuple[Path, Path]:
    """Temporary file and target that a line of INCOMPLETE.txt names. Raises ValueError, TypeError or KeyError for any other text."""
    entry = json.loads(line)
    inside = Path(entry["name"])
    target = Path(os.path.realpath(folder / entry["name"]))
    home = os.path.realpath(folder)
    if inside.is_absolute() or not target.is_relative_to(home) or not _is_partial_of(target.name, entry["from"]):
        raise ValueError(line)
    return target.with_name(entry["from"]), target


def _replace_set(folder: Path, files: Mapping[str, Content], on_disk: Callable[[str, Path], object]) -> None:
    finish_set(folder)
    targets = {name: _target(folder / name, folder) for name in files}
    partials: dict[str, Path] = {}
    try:
        for name, content in files.items():
            partials[name] = _partial(targets[name])
            _put(partials[name], content)
            _prepare(partials[name], targets[name])
        for name, partial in partials.items():
            on_disk(name, partial)
        if len(partials) > 1:
            for parent in {target.parent for target in targets.values()}:
                sync_folder(parent)  # a list of files whose temporary names a power cut may take would list nothing
            _list_set(folder, partials)
    except BaseException:
        if not (folder / INCOMPLETE).exists():  # else the set is the new one, whatever else happens
            for partial in partials.values():
                _remove(partial)
        raise
    _rename_set(folder, [(partials[name], targets[name]) for name in files])


def _put(partial: Path, content: Content) -> None:
    """Write the content of one file under a temporary name."""
    if callable(content):
        content(partial)
    else:
        partial.write_bytes(content.encode("utf-8", errors="surrogateescape") if isinstance(content, str) else content)


def _list_set(folder: Path, partials: Mapping[str, Path]) -> None:
    """Write INCOMPLETE.txt, whole and on the disk: from here on the set is the new one."""
    lines = [json.dumps({"name": name, "from": partial.name}) for name, partial in partials.items()]
    note = _partial(folder / INCOMPLETE)
    try:
        note.write_text("\n".join((_SAYS, *lines)) + "\n", encoding="utf-8")
        publish(note, folder / INCOMPLETE)
    finally:
        _remove(note)


def _rename_set(folder: Path, pairs: Sequence[tuple[Path, Path]]) -> None:
    """Give the files of a set their names; one that another process gave its name already is passed over."""
    for partial, target in pairs:
        with suppress(FileNotFoundError):
            os.replace(partial, target)
    for parent in {target.parent for _, target in pairs}:
        sync_folder(parent)
    if len(pairs) > 1:
        (folder / INCOMPLETE).unlink(missing_ok=True)
        sync_folder(folder)


def _new_folder(folder: Path, files: Mapping[str, Content], on_disk: Callable[[str, Path], object]) -> None:
    partial = _partial(_target(folder))
    _remove(partial)
    try:
        partial.mkdir()
        for name, content in files.items():
            _make_folder((partial / name).parent)
            _put(partial / name, content)
            sync_file(partial / name)
            sync_folder((partial / name).parent)
        for name in files:
            on_disk(name, partial / name)
        os.replace(partial, folder)
    finally:
        _remove(partial)
    sync_folder(folder.parent)


def _target(path: Path, folder: Path | None = None) -> Path:
    """``inside_folder``, in a folder that exists."""
    target = inside_folder(path, folder)
    _make_folder(target.parent)
    return target


def _make_folder(folder: Path) -> None:
    """Make a folder and those above it, with their names on the disk."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    for place in reversed(missing):
        place.mkdir(exist_ok=True)
        sync_folder(place.parent)


def _partial(target: Path) -> Path:
    """A name in the same folder that no other process or thread writes to. Those that killed processes left behind are removed."""
    stem = target.name.encode("utf-8", errors="surrogateescape")[:_NAME_BYTES].decode("utf-8", errors="ignore")
    with suppress(OSError):
        for old in target.parent.iterdir():
            if _is_partial_of(stem, old.name) and time.time() - old.stat().st_mtime > ABANDONED_S:
                _remove(old)
    return fresh(target.with_name(f"{stem}.{os.getpid()}-{threading.get_ident() % 100_000}{PART}"))


def _is_partial_of(name: str, partial: str) -> bool:
    """Whether a file name is that of a temporary file which is to become ``name``, or begins as it does."""
    stem = name.encode("utf-8", errors="surrogateescape")[:_NAME_BYTES].decode("utf-8", errors="ignore")
    return re.fullmatch(rf"{re.escape(stem)}\.\d+-\d+{PART}", partial) is not None


def _remove(path: Path) -> None:
    with suppress(OSError):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _prepare(partial: Path, target: Path) -> None:
    """The temporary file on the disk, with the rights of the one that it replaces. Raises OSError if that one may not be written."""
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
    if target.exists():
        if not os.access(target, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))
        with suppress(OSError):
            shutil.copymode(target, partial)
    sync_file(partial)


def sync_file(path: Path) -> None:
    """Bring a file to the disk, where it can be synchronised. Raises OSError.

    ``os.fsync`` works on a handle that may be written, on POSIX and on Windows."""
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise
    finally:
        os.close(handle)


def _unwritable(path: Path, error: OSError) -> RecordingError:
    return RecordingError(f"{path} cannot be written: {error.strerror or error}; free the disk or choose another place")
