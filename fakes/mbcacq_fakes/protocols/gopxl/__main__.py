"""A fake GoPxL sensor on its own, looking at a ball on a plate: ``python -m mbcacq_fakes.protocols.gopxl --help``.

Any client of the protocol may connect, the vendor's library and its samples included.
"""

from __future__ import annotations

import argparse
import json
import signal
import threading

from mbcacq_fakes.protocols.gocator.scene import ball_on_plate
from mbcacq_fakes.protocols.gopxl.discovery import PORT as DISCOVERY_PORT
from mbcacq_fakes.protocols.gopxl.server import FakeGoPxL, FakeGoPxLOptions


def main() -> None:
    parser = argparse.ArgumentParser(prog="mbcacq_fakes.protocols.gopxl", description=__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on; 0.0.0.0 for all")
    for name, port in (("control", 3600), ("data", 3601)):
        parser.add_argument(f"--{name}-port", type=int, default=port, help=f"default {port}; 0 for any free one")
    parser.add_argument("--no-discovery", action="store_true", help=f"do not answer on udp {DISCOVERY_PORT}")
    parser.add_argument("--model", default="3504")
    parser.add_argument("--serial", type=int, default=12345)
    parser.add_argument("--pixels", type=int, nargs=2, default=(1200, 1600), metavar=("ROWS", "COLUMNS"))
    parser.add_argument("--scan-time", type=float, default=0.1, metavar="S", help="duration of an exposure")
    given = parser.parse_args()
    frame = ball_on_plate(*given.pixels)
    done = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: done.set())
    options = FakeGoPxLOptions(
        host=given.host,
        control_port=given.control_port,
        data_port=given.data_port,
        model=given.model,
        serial=given.serial,
        scan_time_s=given.scan_time,
        discovery_port=None if given.no_discovery else DISCOVERY_PORT,
    )
    with FakeGoPxL(lambda exposure_us: frame, options) as sensor:
        print(json.dumps({"host": given.host, **sensor.ports._asdict(), "model": given.model, "serial": given.serial}), flush=True)
        done.wait()


if __name__ == "__main__":
    main()
