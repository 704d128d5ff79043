"""The ACME thermometer: TCP, a line `T?` is answered by the temperature, `ID?` by model and serial number."""

from __future__ import annotations

import math
import socket
from collections.abc import Mapping
from typing import Any, Self

from mbcacq.devices import ConfigError, ConnectError, Description, DeviceTimeout, Field, IdentityError, ProtocolError

LONGEST = 80


class AcmeProbe:
    """A sensor with one value, air_C. Options: address, port, timeout_s. ``model``: what the thermometer must call itself."""

    verified_on_hardware = "T-1000, by the author"  # what `mbcacq drivers` shows; leave it out until you have tried

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        """Only checks; nothing is opened before ``connect``."""
        known = {"address": "", "port": 4001, "timeout_s": 2.0}
        if unknown := sorted(set(options) - set(known)):
            raise ConfigError(f"sensor '{name}': unknown option '{unknown[0]}' (known: {', '.join(known)}); correct the plan")
        given = known | dict(options)
        if not given["address"]:
            raise ConfigError(f"sensor '{name}': the option address is missing; give the thermometer's IP address")
        self._where, self._timeout_s = (str(given["address"]), int(given["port"])), float(given["timeout_s"])
        self._name, self._model, self._serial, self._socket = f"sensor '{name}' at {given['address']}", model, "", None

    def describe(self) -> Description:
        """Works before connecting as well."""
        return Description("sensor", self._model, (Field("air_C", "C", meaning="air beside the robot"),), self._serial)

    def connect(self) -> None:
        self.close()
        try:
            self._socket = socket.create_connection(self._where, self._timeout_s)
        except OSError as error:
            raise ConnectError(f"{self._name} does not answer ({error}); is it on, and is the address right?") from error
        try:
            model, _, self._serial = self._ask("ID?").partition(" ")
        except (DeviceTimeout, ProtocolError) as error:
            self.close()
            raise ConnectError(f"{self._name} cannot be identified: {error}") from error
        if self._model not in ("", model):
            self.close()
            raise IdentityError(f"{self._name} is a '{model}', not a '{self._model}'; correct the address or the plan")

    def read(self) -> dict[str, float]:
        text = self._ask("T?")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not -50.0 < value < 100.0:
            raise ProtocolError(f"{self._name} sent '{text}' as its temperature; is the probe plugged in?")
        return {"air_C": value}

    def stop(self) -> None:
        """Nothing of it moves."""

    def close(self) -> None:
        sock, self._socket = self._socket, None
        if sock is not None:
            sock.close()

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, question: str) -> str:
        """One question, one line. After any doubt the connection is closed: a late answer must not pass for the next one."""
        if self._socket is None:
            raise ConnectError(f"{self._name} is not connected")
        heard = b""
        try:
            self._socket.sendall(f"{question}\n".encode())
            while not heard.endswith(b"\n") and len(heard) < LONGEST:
                if not (data := self._socket.recv(LONGEST)):
                    raise OSError("it closed the connection")
                heard += data
        except OSError as error:
            self.close()
            raise DeviceTimeout(f"{self._name} was lost: {error or 'it is silent'}; check the cable") from error
        if not heard.endswith(b"\n") or heard.count(b"\n") > 1 or not heard.isascii():
            self.close()
            raise ProtocolError(f"{self._name} sent {heard[:20]!r} instead of one line; is another program talking to it?")
        return heard.decode("ascii").strip()
