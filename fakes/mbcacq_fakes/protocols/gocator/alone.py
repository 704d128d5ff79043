"""A fake sensor on its own: what both kinds of sensor are asked on the command line, and how long it runs."""

from __future__ import annotations

import argparse
import json
import signal
import time
from typing import Any


def sensor_parser(prog: str, doc: str | None, ports: dict[str, int], model: str) -> argparse.ArgumentParser:
    """Arguments of every sensor. ports: name and number of each."""
    parser = argparse.ArgumentParser(prog=prog, description=doc)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on; 0.0.0.0 for all")
    for name, port in ports.items():
        parser.add_argument(f"--{name}-port", type=int, default=port, help=f"default {port}; 0 for any free one")
    parser.add_argument("--model", default=model)
    parser.add_argument("--pixels", type=int, nargs=2, default=(1200, 1600), metavar=("ROWS", "COLUMNS"))
    parser.add_argument("--scan-time", type=float, default=0.1, metavar="S", help="duration of an exposure")
    return parser


def run_until_signal(made: Any, **about: object) -> None:
    """Open a sensor, print where it listens as one JSON object, and wait for SIGINT or SIGTERM. about: what else is printed."""
    done: list[int] = []  # no event: a second signal inside of its set() would wait for the first for ever
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: done.append(number))
    with made as sensor:
        print(json.dumps({**sensor.ports._asdict(), **about}), flush=True)
        while not done:
            time.sleep(0.1)
