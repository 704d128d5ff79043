"""The connection under a Modbus request: opened with the system's own words, found closed before anything is sent, emptied of late answers.

pymodbus codes and decodes; when to connect, to wait and to discard is decided here, because its own client does so silently.
"""

from __future__ import annotations

import select
import socket
import threading
import time
from contextlib import suppress
from typing import Any

from mbcacq.devices import ConnectError, open_tcp, reason
from mbcacq_bus.modbus_connection import Connection
from mbcacq_bus.serial_port import close_port, open_port, waiting_bytes

_PEEK = 4096
_STEP_S = 0.005


class Closed(Exception):
    """The far end has closed the connection; nothing was sent meanwhile."""


class Transport:
    """One open connection, Modbus TCP or RTU. Not safe for several threads.

    Parameters
    ----------
    device : str
        Name of the device for messages.
    options : Connection
        Where it is, and how its line is set.
    """

    def __init__(self, device: str, options: Connection) -> None:
        self._device, self._options = device, options
        self._client: Any = None

    @property
    def is_open(self) -> bool:
        return self._client is not None and self._client.socket is not None

    def open(self) -> None:
        """Raises ConnectError with the reason that the system gives."""
        from pymodbus.client import ModbusSerialClient, ModbusTcpClient

        o = self._options
        if o.host:
            client: Any = ModbusTcpClient(o.host, port=o.port, timeout=o.timeout_s, retries=0)
            client.socket = self._connected(o.host, o.port)
        else:
            line: dict[str, Any] = {"baudrate": o.baudrate, "parity": o.parity, "stopbits": o.stopbits}
            client = ModbusSerialClient(str(o.serial), timeout=o.timeout_s, retries=0, **line)
            client.socket = open_port(self._device, str(o.serial), **line, timeout=o.timeout_s, write_timeout=o.timeout_s)
            with suppress(Exception):  # not every kind of port of pyserial has it
                client.socket.inter_byte_timeout = client.inter_byte_timeout
        self._client = client

    def close(self) -> None:
        client, self._client = self._client, None
        if client is None:
            return
        if self._options.host:
            with suppress(Exception):
                client.close()
        else:
            close_port(client.socket)
            client.socket = None

    @property
    def client(self) -> Any:
        """The client of pymodbus, connected."""
        return self._client

    def discard(self) -> int:
        """Throw away what has come unasked. Returns its bytes; raises Closed where the connection has ended."""
        if not self.is_open:
            raise Closed
        try:
            return self._empty_socket() if self._options.host else len(waiting_bytes(self._client.socket))
        except Closed:
            raise
        except Exception as error:  # pyserial lets termios.error and TypeError of a lost port through
            raise Closed from error

    def wait_for_silence(self, quiet_s: float, longest_s: float, until: float, hurry: threading.Event) -> tuple[int, bool]:
        """Discard until nothing has come for ``quiet_s``, and not before ``until`` (time.monotonic).

        Returns
        -------
        tuple[int, bool]
            Number of bursts discarded, and whether the line fell silent within ``longest_s`` (also True if ``hurry`` was set).
        """
        bursts, now = 0, time.monotonic()
        end, silent_at, last = now + longest_s, max(now + quiet_s, until), -1e9
        while (now := time.monotonic()) < silent_at and not hurry.is_set():
            if now > max(end, until):
                return bursts, False
            if self.discard():
                bursts += now - last > 10 * _STEP_S
                last, silent_at = now, max(now + quiet_s, until)
            hurry.wait(_STEP_S)
        return bursts, True

    def _connected(self, host: str, port: int) -> socket.socket:
        try:
            return open_tcp(host, port, self._options.timeout_s)
        except OSError as error:
            raise ConnectError(
                f"{self._device} does not answer at {host}:{port} ({reason(error)}); is it on, and is the address right?"
            ) from error

    def _empty_socket(self) -> int:
        sock, count = self._client.socket, 0
        while select.select([sock], [], [], 0)[0]:
            data = sock.recv(_PEEK)
            if not data:
                raise Closed
            count += len(data)
        return count
