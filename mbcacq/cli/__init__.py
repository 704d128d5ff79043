"""The ``mbcacq`` command. One small file a subcommand, imported only when it is called."""

from __future__ import annotations


def main() -> None:
    from mbcacq.cli.app import app

    app()
