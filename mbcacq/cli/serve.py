"""``mbcacq serve``: runs to look at in a browser, on this computer."""

from __future__ import annotations

from pathlib import Path

import click

from mbcacq.cli.declared import argument, option, subcommand
from mbcacq.cli.signals import end_in_order_on_signals
from mbcacq.cli.terminal import echo
from mbcacq.errors import Aborted
from mbcacq.serve.server import refuse_other_address, serve


@subcommand("serve")
def command(
    runs: Path = argument(default="runs"),
    port: int = option("Port of the page; 0 takes a free one.", click.IntRange(0, 65535), default=8765),
    host: str = option("Only this computer's own address is accepted.", default="127.0.0.1"),
    open_browser: bool = option("Open the page in the browser of this desktop.", None, "--open"),
) -> None:
    """Show RUNS in a browser: verdicts, reports side by side, plans in 3D, fleets, and a run that goes on, with its stop.

    RUNS is a folder below which run folders and fleets lie [default: runs]. The page can be opened on this computer only. It starts
    nothing and moves nothing; its stop button does what Ctrl-C does in the terminal of the run, and is no emergency stop. Ctrl-C ends it.

    \b
    Examples:
      mbcacq serve
      mbcacq serve runs --open
    """
    refuse_other_address(host)

    def began(address: str) -> None:
        echo(f"{runs} is shown at {address} on this computer; Ctrl-C ends it")
        if open_browser:
            import webbrowser

            webbrowser.open(address)

    end_in_order_on_signals("the page")
    try:
        serve(runs, port, began)
    except (KeyboardInterrupt, Aborted):
        echo("the page has ended; runs go on", err=True)
