"""The ``mbcacq`` command. One small file a subcommand, imported only when it is called."""

from __future__ import annotations

import os


def main() -> None:
    # Many small matrices: threads of the linear algebra wait for each other more than they help, most of all while other programs run.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
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
