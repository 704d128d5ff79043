"""The ``mbcacq`` command. One small file a subcommand, imported only when it is called."""

from __future__ import annotations

import os


def main() -> None:
    # Many small matrices: threads of the linear algebra wait for each other more than they help, most of all while other programs run.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from mbcacq.cli.app import app

    app()
