"""The ``mbcacq`` command. One small file a subcommand, imported only when it is called."""

from __future__ import annotations

import os


def main() -> None:
    _open_standard_streams()
    # Many small matrices: threads of the linear algebra wait for each other more than they help, most of all while other programs run.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # mimalloc, of pyarrow and of rerun, reserves a GiB of addresses each: too many where a limit is set on them (ulimit -v).
    os.environ.setdefault("MIMALLOC_ARENA_RESERVE", "64M")
    import signal
    import sys

    try:
        from mbcacq.cli.signals import interrupt_once

        interrupt_once()
        from mbcacq.cli.app import app

        app()
    except KeyboardInterrupt:  # outside of what the command group handles: while it is loaded, while it ends
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        sys.stderr.write("mbcacq: interrupted\n")
        sys.exit(130)  # ExitCode.INTERRUPTED, which may not be loaded yet
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is done: the interpreter, while it ends, would let it end us by the signal


def _open_standard_streams() -> None:
    """Where the caller closed one of the three (``2>&-``), what is said goes nowhere, and the next file that is opened does not get its
    number: a library's complaint would be written into a recording."""
    import sys

    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            nothing = os.open(os.devnull, os.O_RDWR)
            if nothing != number:
                os.dup2(nothing, number)
                os.close(nothing)
            setattr(sys, name, os.fdopen(number, "r" if number == 0 else "w", encoding="utf-8", errors="backslashreplace", closefd=False))
