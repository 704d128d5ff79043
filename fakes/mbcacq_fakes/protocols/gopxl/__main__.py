"""A fake GoPxL sensor on its own, looking at a ball on a plate: ``python -m mbcacq_fakes.protocols.gopxl --help``.

Any client of the protocol may connect, the vendor's library and its samples included.
"""

from __future__ import annotations

from mbcacq_fakes.protocols.gocator.alone import run_until_signal, sensor_parser
from mbcacq_fakes.protocols.gocator.scene import ball_on_plate
from mbcacq_fakes.protocols.gopxl.discovery import PORT as DISCOVERY_PORT
from mbcacq_fakes.protocols.gopxl.server import FakeGoPxL, FakeGoPxLOptions


def main() -> None:
    parser = sensor_parser("mbcacq_fakes.protocols.gopxl", __doc__, {"control": 3600, "data": 3601}, "3504")
    parser.add_argument("--no-discovery", action="store_true", help=f"do not answer on udp {DISCOVERY_PORT}")
    parser.add_argument("--serial", type=int, default=12345)
    given = parser.parse_args()
    frame = ball_on_plate(*given.pixels)
    options = FakeGoPxLOptions(
        host=given.host,
        control_port=given.control_port,
        data_port=given.data_port,
        model=given.model,
        serial=given.serial,
        scan_time_s=given.scan_time,
        discovery_port=None if given.no_discovery else DISCOVERY_PORT,
    )
    run_until_signal(FakeGoPxL(lambda exposure_us: frame, options), host=given.host, model=given.model, serial=given.serial)


if __name__ == "__main__":
    main()
