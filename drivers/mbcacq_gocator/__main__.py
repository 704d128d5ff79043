"""Lists the Gocators on the networks of this computer: ``python -m mbcacq_gocator``."""

from __future__ import annotations

import sys

from mbcacq.devices import ConnectError
from mbcacq_gocator.discovery import find_sensors


def main() -> int:
    try:
        found = find_sensors(1.0)
    except ConnectError as error:
        print(error, file=sys.stderr)
        return int(error.exit_code)
    for sensor in found:
        firmware = ".".join(map(str, sensor.firmware)) if any(sensor.firmware) else "before 5.1"
        print(f"{sensor.model or 'Gocator'}  serial {sensor.serial}  firmware {firmware}  at {sensor.address}/{sensor.prefix_length}")
    if not found:
        print("no Gocator answered; check power and cable, and that the firewall lets udp from port 3220 in", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
