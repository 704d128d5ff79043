"""The library of faults in this process, and work in a child process that it hurts."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

SOURCE = Path(__file__).with_name("system_call_faults.c")
FOREIGN = 99  # exit code of a child that ended by an exception which is no end of a program
Work = Callable[[], object]


def preload() -> ctypes.CDLL:
    """The library of this process; starts the program again with it where it is not there yet."""
    if "FAULT_LIBRARY" not in os.environ:
        library = Path(tempfile.mkdtemp(prefix="faults-")) / "system_call_faults.so"
        subprocess.run(["gcc", "-O2", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"], check=True)
        os.environ |= {"FAULT_LIBRARY": str(library), "LD_PRELOAD": str(library)}
        os.execv(sys.executable, [sys.executable, *sys.argv])
    library = ctypes.CDLL(os.environ["FAULT_LIBRARY"])
    library.fault_name.restype = ctypes.c_char_p
    library.fault_count.restype = ctypes.c_long
    library.fault_arm.argtypes = [ctypes.c_char_p, ctypes.c_long, ctypes.c_int]
    library.fault_clock.argtypes = [ctypes.c_long]
    library.fault_below.argtypes = [ctypes.c_char_p]
    library.fault_record.argtypes = [ctypes.c_char_p, ctypes.c_char_p]
    return library


def command(*arguments: object) -> Work:
    """A command line of mbcacq, run in this process."""

    def work() -> object:
        from mbcacq.cli.app import app

        return app.main([str(a) for a in arguments])

    return work


def called(function: Work) -> Work:
    """A function of the library, which ends as its command would where it fails."""

    def work() -> object:
        from mbcacq.errors import MbcacqError

        try:
            return function()
        except MbcacqError as error:
            raise SystemExit(int(error.exit_code)) from error

    return work


def in_child(work: Work) -> int:
    """Exit code of the work in a process of its own, negative for a signal."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)
        try:
            work()
            os._exit(0)
        except SystemExit as end:
            os._exit(int(end.code or 0))
        except BaseException:
            os._exit(FOREIGN)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def recorded(library: ctypes.CDLL, folder: Path, log: Path, work: Work) -> Work:
    """The work, whose writes, synchronisations and names below the folder are recorded, those of programs that it starts too."""

    def noted() -> object:
        library.fault_record(str(folder).encode(), str(log).encode())
        os.environ["FAULT_RECORD"] = f"{folder}|{log}"
        return work()

    return noted


def killed_at(number: int, folder: Path, work: Work, count: Path | None = None) -> Work:
    """The work, ended by SIGKILL at the so-manieth file below the folder that it opens, renames, removes or makes. count: gets how many
    there were.
    """

    def struck() -> object:
        left = number

        def hook(event: str, arguments: tuple) -> None:
            nonlocal left
            if event in ("open", "os.rename", "os.remove", "os.mkdir") and str(folder) in str(arguments[0]):
                left -= 1
                if left == 0:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        try:
            return work()
        finally:
            if count is not None:
                count.write_text(str(number - left))

    return struck


def full_from(write: int, library: ctypes.CDLL, folder: Path, work: Work) -> Work:
    """The work, for which there is no space from this write below the folder on (0 is the first)."""

    def full() -> object:
        library.fault_below(str(folder).encode())
        library.fault_arm(b"write", write, errno.ENOSPC)
        return work()

    return full
