"""A fake Gocator on its own, looking at a ball on a plate: ``python -m mbcacq_fakes.protocols.gocator --help``.

Any client of the protocol may connect, the vendor's library included.
"""

from __future__ import annotations

from mbcacq_fakes.protocols.gocator.alone import run_until_signal, sensor_parser
from mbcacq_fakes.protocols.gocator.options import FakeGocatorOptions
from mbcacq_fakes.protocols.gocator.scene import ball_on_plate
from mbcacq_fakes.protocols.gocator.server import FakeGocator


def main() -> None:
    parser = sensor_parser("mbcacq_fakes.protocols.gocator", __doc__, {"control": 3190, "health": 3194, "data": 3196}, "3210")
    parser.add_argument("--discovery", action="store_true", help="answer discovery on udp 3220, on all interfaces")
    parser.add_argument("--generation", type=int, choices=(4, 5, 6), default=6, help="firmware generation")
    parser.add_argument("--uniform", action="store_true", help="switch uniform spacing on in the jobs")
    parser.add_argument("--frame-rate", type=float, default=0.0, metavar="HZ", help="trigger jobs by time, so often; 0: by software")
    given = parser.parse_args()
    frame = ball_on_plate(*given.pixels)
    options = FakeGocatorOptions(
        host=given.host,
        control_port=given.control_port,
        health_port=given.health_port,
        data_port=given.data_port,
        discovery=given.discovery,
        model=given.model,
        generation=given.generation,
        uniform=given.uniform,
        scan_time_s=given.scan_time,
        frame_rate_hz=given.frame_rate,
    )
    run_until_signal(FakeGocator(lambda exposure_us: frame, options), host=given.host, model=given.model, serial=options.serial)


if __name__ == "__main__":
    main()
