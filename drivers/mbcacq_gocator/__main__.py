"""Lists the LMI sensors of both generations on the networks of this computer: ``python -m mbcacq_gocator``."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

from mbcacq.devices import ConnectError
from mbcacq_gocator.discovery import FoundSensor, find_sensors
from mbcacq_gocator.gopxl import discovery as gopxl
from mbcacq_gocator.gopxl.discovery import FoundInstance

_LISTEN_S = 1.0


def main() -> int:
    try:
        with ThreadPoolExecutor(2) as pool:
            asked = pool.submit(gopxl.find, _LISTEN_S), pool.submit(find_sensors, _LISTEN_S)
            instances, sensors = asked[0].result(), asked[1].result()
    except ConnectError as error:
        print(error, file=sys.stderr)
        return int(error.exit_code)
    new = {instance.serial for instance in instances}
    lines = [*map(_instance, instances), *(_sensor(s) for s in sensors if s.serial not in new)]  # GoPxL may answer in the old way too
    print("\n".join(lines), end="\n" if lines else "")
    if not lines:
        lets = "that the firewall lets udp from port 3220 (Gocator) and to port 3320 (GoPxL) in"
        print(f"no sensor answered; check power and cable, and {lets}", file=sys.stderr)
    return 0


def _instance(found: FoundInstance) -> str:
    remark = "  controlled by another instance" if found.remote else ""
    remark += "  its address is taken twice" if found.conflict else ""
    where = f"{found.address}, control {found.control_port}, data {found.data_port}"
    return f"{found.model or 'sensor'}  serial {found.serial}  GoPxL {found.build or 'of unknown build'}  at {where}{remark}"


def _sensor(found: FoundSensor) -> str:
    firmware = ".".join(map(str, found.firmware)) if any(found.firmware) else "before 5.1"
    return f"{found.model or 'Gocator'}  serial {found.serial}  firmware {firmware}  at {found.address}/{found.prefix_length}"


if __name__ == "__main__":
    sys.exit(main())
