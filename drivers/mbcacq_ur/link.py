"""The connection to a controller: what is exchanged is agreed upon, then every package is answered by the latest command."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from mbcacq.devices import ConnectError, DeviceTimeout, LinkLost, MbcacqError, ProtocolError, TcpLink
from mbcacq_ur import wire
from mbcacq_ur.options import UrOptions
from mbcacq_ur.wire import BadPackage, DataLayout, RefusedValues

SENT = tuple(
    """
timestamp actual_q actual_qd target_q actual_current joint_temperatures robot_mode safety_status_bits runtime_state target_speed_fraction
payload payload_cog output_int_register_0 output_int_register_1 output_int_register_2
""".split()
)
SWITCHED = ("standard_digital_output_mask", "standard_digital_output")  # where digital outputs may be switched
TAKEN = (*(f"input_double_register_{k}" for k in range(8)), *(f"input_int_register_{k}" for k in range(3)))
Values = Mapping[str, Any]


class RtdeLink:
    """``on_values`` is called with every package and gives the registers of the answer; ``on_error`` with what ended the exchange.

    Under the option follow no registers are asked for, and nothing is sent once the exchange has begun.
    """

    def __init__(
        self, name: str, options: UrOptions, on_values: Callable[[Values], Values], on_error: Callable[[MbcacqError], None]
    ) -> None:
        self._name, self._options = name, options
        self._on_values, self._on_error = on_values, on_error
        self._buffer, self._quit = bytearray(), threading.Event()
        self._link: TcpLink | None = None
        self._thread: threading.Thread | None = None
        self._taken: DataLayout | None = None
        self._stops = "" if options.follow else " the arm stops by its watchdog,"
        self.version = ""

    @property
    def open(self) -> bool:
        return self._link is not None

    def connect(self) -> None:
        """Raises ConnectError, ProtocolError."""
        o, place = self._options, f"{self._options.address}:{self._options.port}"
        try:
            link = self._link = TcpLink("the controller", o.address, o.port, o.connect_timeout_s, o.silence_s)
            self._agree(link)
        except TimeoutError as error:
            self.close()
            raise ConnectError(f"{self._name} at {place} does not answer; is RTDE enabled (Settings, Security, Services)?") from error
        except RefusedValues as error:
            self.close()
            raise ProtocolError(f"{self._name} at {place} {error}") from error
        except (BadPackage, struct.error, UnicodeDecodeError) as error:
            self.close()
            raise ProtocolError(f"{self._name} at {place} does not speak RTDE version 2 as expected: {error}") from error
        except (OSError, LinkLost) as error:
            self.close()
            why = getattr(error, "strerror", None) or error
            raise ConnectError(f"{self._name}: no connection to {place} ({why}); check address and cable") from error
        self._thread = threading.Thread(target=self._exchange, args=(link,), name="ur-rtde", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Idempotent, from any thread."""
        self._quit.set()
        link, self._link = self._link, None
        if link is not None:
            link.close()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(5.0)

    def _agree(self, link: TcpLink) -> None:
        if self._ask(link, wire.VERSION, struct.pack(">H", 2)) != b"\x01":
            raise BadPackage("version 2 is refused")
        if len(version := self._ask(link, wire.CONTROLLER)) == 16:
            self.version = ".".join(map(str, struct.unpack(">4I", version)))
        wanted = struct.pack(">d", self._options.frequency_hz) + ",".join(SENT).encode()
        self._sent = DataLayout(SENT, self._ask(link, wire.OUTPUTS, wanted))
        if not self._options.follow:
            taken = (*TAKEN, *(SWITCHED if self._options.digital_outputs else ()))
            self._taken = DataLayout(taken, self._ask(link, wire.INPUTS, ",".join(taken).encode()))
        if self._ask(link, wire.START) != b"\x01":
            raise BadPackage("the exchange is refused")

    def _ask(self, link: TcpLink, kind: int, payload: bytes = b"") -> bytes:
        """The answer of the same type; texts and early data in between are passed over."""
        link.send(wire.packed(kind, payload))
        deadline = time.monotonic() + self._options.silence_s
        while (left := deadline - time.monotonic()) > 0:
            for found, content in wire.split(self._buffer):
                if found == kind:
                    return content
                if found not in (wire.TEXT, wire.DATA):
                    raise BadPackage(f"an answer of type {found} instead of {kind}")
            self._buffer += link.receive(left)[1]
        raise TimeoutError

    def _answer(self, link: TcpLink) -> None:
        """Hand on every package that has come, and answer it by the registers, but for an arm that is only followed."""
        for kind, payload in wire.split(self._buffer):
            if kind == wire.DATA:
                answer = self._on_values(self._sent.read(payload))
                if self._taken is not None:
                    link.send(self._taken.write(answer))

    def _exchange(self, link: TcpLink) -> None:
        """Thread: every package, until the connection ends or something is wrong."""
        try:
            while not self._quit.is_set():
                self._answer(link)
                _, data = link.receive(self._options.silence_s)
                if not data:
                    raise TimeoutError
                self._buffer += data
        except MbcacqError as error:
            self._on_error(error)
        except TimeoutError:
            silent = f"{self._name}: silent for {self._options.silence_s:g} s;{self._stops} check controller and cable"
            self._on_error(DeviceTimeout(silent))
        except (BadPackage, struct.error) as error:
            self._on_error(ProtocolError(f"{self._name}: {error};{self._stops} the connection was given up"))
        except LinkLost as error:
            if not self._quit.is_set():
                broken = f"{self._name}: the connection broke ({error});{self._stops} check the cable"
                self._on_error(ConnectError(broken))
