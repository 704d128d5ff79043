"""Which generation of firmware answers at an address: classic Gocator firmware, or GoPxL. A port that accepts tells; nothing is sent."""

from __future__ import annotations

import socket

CLASSIC_CONTROL, GOPXL_CONTROL = 3190, 3600
_WAIT_S = 0.5


def answers(address: str, port: int) -> bool:
    try:
        with socket.create_connection((address, port), _WAIT_S):
            return True
    except OSError:
        return False
