"""Opening of serial ports, for every device on one."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from mbcacq.devices import ConnectError


def open_port(device: str, url: str, baudrate: int, parity: str, stopbits: int, bytesize: int = 8, **more: float) -> Any:
    """A serial port of pyserial, for this program alone: two that read one line take each other's answers.

    Parameters
    ----------
    device : str
        Name of the device for messages.
    url : str
        A device's name (/dev/ttyUSB0, COM3), or socket://host:port of a serial server.
    baudrate, parity, stopbits, bytesize
        Settings of the line.
    **more : float
        Time limits, s, as pyserial names them.

    Raises
    ------
    ConnectError
        The port is missing, busy or not permitted, or refuses these settings; in the words of pyserial.
    """
    import serial

    settings: dict[str, Any] = {"baudrate": baudrate, "parity": parity, "stopbits": stopbits, "bytesize": bytesize, **more}
    port = None
    try:
        port = serial.serial_for_url(url, exclusive=True, **settings)
        # Sets them once more: POSIX reports no refusal of one setting as long as another one was taken.
        port.inter_byte_timeout = port.inter_byte_timeout
        return port
    except Exception as error:  # pyserial lets termios.error of a refused setting through, which is no OSError
        close_port(port)
        line = f"{baudrate} baud, {bytesize}{parity}{stopbits}"
        raise ConnectError(
            f"{device} cannot be opened at {url} ({line}): {_reason(error)}; check the port's name, the cable, the line's settings, "
            "your right to use it, and that no other program has it"
        ) from error


def waiting_bytes(port: Any) -> bytes:
    """Bytes that have come and were not read. Raises whatever pyserial raises where the port is lost or its far end has closed."""
    heard = b""
    while waiting := port.in_waiting:
        heard += port.read(waiting)
    return heard


def close_port(port: Any) -> None:
    """Close; never raises."""
    if port is None:
        return
    sock = getattr(port, "_socket", None)  # pyserial leaves the socket of a lost connection open
    with suppress(Exception):
        port.close()
    if sock is not None:
        sock.close()


def _reason(error: Exception) -> str:
    """What the system said; termios.error holds a number and a text."""
    if len(error.args) == 2 and isinstance(error.args[1], str):
        return error.args[1]
    return str(error)
