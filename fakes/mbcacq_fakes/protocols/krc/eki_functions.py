"""The EKI_ functions that KRL calls, on one channel; strict about names and types, as the controller and its XML file are."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

from mbcacq_fakes.protocols.krc.eki_channel import EkiChannel
from mbcacq_fakes.protocols.krc.eki_telegram import fill, number, subtree
from mbcacq_fakes.protocols.krc.krl.values import KrlError, Struct

_OK, _NO_CHANNEL, _AGAIN, _NOT_CONNECTED, _EMPTY = 0, 1, 23, 9, 17


class EkiFunctions:
    """``table()``: by name in lower case, for krl.Program; every one is a generator, as its caller is one. Raises KrlError for what the
    channel's XML does not say."""

    def __init__(self, channel: EkiChannel) -> None:
        self._channel, self._config = channel, channel.config
        self._loaded = False
        self._values: dict[str, Any] = {}
        self._current: dict[str, Any] = {}

    def table(self) -> dict[str, Any]:
        kss = {"eki_init": self._load, "eki_clear": self._unload, "eki_checkbuffer": self._check_buffer, "eki_close": self._close}
        new = {"eki_load": self._load, "eki_unload": self._unload, "eki_readnext": self._read_next}
        both: dict[str, Any] = {"eki_open": self._open, "eki_send": self._send}
        for kind in ("Int", "Real", "Bool", "String", "Frame"):
            both[f"eki_get{kind.lower()}"] = lambda *a, kind=kind: self._get(kind.upper(), *a)
            both[f"eki_set{kind.lower()}"] = lambda *a, kind=kind: self._set(kind.upper(), *a)
        return {name: _generator(f) for name, f in (both | (kss if self._config.system == "kss" else new)).items()}

    def _status(self, number: int, buff: int = 0) -> Any:
        if self._config.system == "iiqka":
            return number
        return Struct(buff=buff, read=0, msg_no=number, connected=self._channel.client is not None, counter=0)

    def _load(self, name: str) -> Any:
        if name != self._channel.name:
            raise KrlError(f"there is no {name}.xml")
        if self._loaded:
            return self._status(_AGAIN)
        self._loaded, self._values = True, {}
        self._channel.empty()
        return self._status(_OK)

    def _unload(self, name: str) -> Any:
        self._known(name)
        self._channel.close()
        self._loaded = False
        self._channel.empty()
        return self._status(_OK)

    def _open(self, name: str) -> Any:
        self._known(name)
        if not self._loaded:
            return self._status(_NO_CHANNEL)
        self._channel.listen()
        return self._status(_OK)

    def _close(self, name: str) -> Any:
        self._known(name)
        self._channel.close()
        return self._status(_OK)

    def _check_buffer(self, name: str, path: str) -> Any:
        self._known(name)
        return self._status(_OK, len(self._buffer(path)))

    def _read_next(self, name: str) -> Any:
        self._known(name)
        if not self._channel.telegrams:
            return self._status(_EMPTY)
        self._current = self._channel.telegrams.popleft()
        return self._status(_OK)

    def _get(self, kind: str, name: str, path: str) -> tuple[Any, Any]:
        self._known(name)
        declared = self._config.received.get(path, ("", ""))[1]
        if declared != kind:
            raise KrlError(f"{path} is asked for as {kind}, but the channel's XML says {declared or 'nothing of it'}")
        if self._config.system == "iiqka":
            value = self._current.get(path)
        else:
            buffer = self._buffer(path)
            value = buffer.popleft() if buffer else None
        return self._status(_OK if value is not None else _EMPTY), value

    def _set(self, kind: str, name: str, path: str, value: Any) -> Any:
        self._known(name)
        if path not in self._config.sent:
            raise KrlError(f"{path} is set, but the channel's XML does not send it")
        if self._config.sent[path] and self._config.sent[path] != kind:
            raise KrlError(f"{path} is set as {kind}, but the template says {self._config.sent[path]}")
        right = {"INT": int, "REAL": float, "BOOL": bool, "STRING": str, "FRAME": Struct}[kind]
        if kind == "REAL" and type(value) is int:
            value = float(value)
        if type(value) is not right:
            raise KrlError(f"{path}: {value!r} is no {kind}")
        self._values[path] = number(_single(value)) if kind == "REAL" else int(value) if kind == "BOOL" else value
        return self._status(_OK)

    def _send(self, name: str, path: str = "") -> Any:
        self._known(name)
        if self._channel.client is None:
            return self._status(_NOT_CONNECTED)
        if self._config.system == "iiqka":
            text = fill(self._config.template, self._values)
        else:
            text = subtree(self._config.order, self._values, path)
            if not text:
                raise KrlError(f"nothing below {path} is sent")
        try:
            self._channel.outlet(self._channel.client, text.encode("latin-1", "replace"))
        except OSError:
            self._channel.drop()
            return self._status(_NOT_CONNECTED)
        return self._status(_OK)

    def _known(self, name: str) -> None:
        if name != self._channel.name:
            raise KrlError(f"there is no channel {name}")

    def _buffer(self, path: str) -> deque[Any]:
        if path not in self._config.received:
            raise KrlError(f"{path} is not received, says the channel's XML")
        return self._channel.buffers[path] if self._loaded else deque()


def _single(value: float) -> float:
    """REAL has 32 bits."""
    return struct.unpack("f", struct.pack("f", value))[0]


def _generator(function: Callable[..., Any]) -> Callable[..., Iterator[Any]]:
    def run(interpreter: Any, *given: Any) -> Iterator[Any]:
        return function(*given)
        yield

    return run
