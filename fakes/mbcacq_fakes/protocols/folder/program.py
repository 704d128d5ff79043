"""The program: one TCP server, one folder. It answers OK and saves ``cloud_0001.ply``, ``cloud_0002.ply``..."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from mbcacq.recording.datasets.scan_folder import write_ply
from mbcacq_fakes.world.frame import ScannerFrame

HOST = "127.0.0.1"
WATCH_S = 0.002
FAULTS = {
    "silent": "the trigger is not acknowledged",
    "refused": "the trigger is answered BUSY, and nothing is saved",
    "no_cloud": "the trigger is acknowledged, but nothing is saved",
    "slowly": "the cloud is saved in two halves, this many seconds apart",
    "half": "only half of the cloud is saved",
    "empty": "an empty file is saved",
    "twice": "a second cloud is saved with the first",
    "touch_old": "nothing is saved, but an old cloud stays where it is",
    "another_name": "the cloud is saved under a name that the pattern does not have",
}


class FakeScannerProgram:
    """Context manager. source: a frame for an exposure; folder: where its clouds go. rises: how often the output of a robot that triggers
    it was switched on so far, or None."""

    def __init__(self, source: Callable[[float], ScannerFrame], folder: Path, rises: Callable[[], int] | None = None) -> None:
        self._source, self._folder, self._rises = source, folder, rises
        self._active: dict[str, Any] = {}
        self.saved = 0
        self._server = socket.create_server((HOST, 0))
        self._server.settimeout(0.1)
        self.port = int(self._server.getsockname()[1])
        self._quit = threading.Event()
        self._thread = threading.Thread(target=self._serve if rises is None else self._watch, name="fake-scanner-program", daemon=True)
        self.faults = self

    def set(self, fault: str, value: Any = True, times: int | None = None) -> None:
        """Give it a fault. Raises ValueError for one that there is none of."""
        if fault not in FAULTS:
            raise ValueError(f"there is no fault '{fault}' (known: {', '.join(FAULTS)})")
        self._active[fault] = value

    def clear(self, fault: str | None = None) -> None:
        """One fault, or all."""
        for name in [fault] if fault else list(self._active):
            self._active.pop(name, None)

    def start(self) -> Self:
        self._thread.start()
        return self

    def stop(self) -> None:
        self._quit.set()
        if self._thread.is_alive():
            self._thread.join(5.0)
        self._server.close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def _watch(self) -> None:
        """A wire from the robot instead of the network."""
        assert self._rises is not None
        seen = self._rises()
        while not self._quit.wait(WATCH_S):
            if (now := self._rises()) != seen:
                seen = now
                self._save()

    def _serve(self) -> None:
        while not self._quit.is_set():
            try:
                connection, _ = self._server.accept()
            except TimeoutError:
                continue
            except OSError:  # closed
                return
            with connection:
                try:
                    self._talk(connection)
                except OSError:
                    continue  # the client is gone

    def _talk(self, connection: socket.socket) -> None:
        connection.settimeout(0.1)
        line = b""
        while not self._quit.is_set():
            try:
                data = connection.recv(1024)
            except TimeoutError:
                continue
            if not data:
                return
            line += data
            while b"\n" in line:
                word, line = line.split(b"\n", 1)
                if word.strip() == b"trigger" and "silent" not in self._active:
                    connection.sendall(b"BUSY\n" if "refused" in self._active else b"OK\n")
                    if "refused" not in self._active:
                        self._save()

    def _save(self) -> None:
        if self._active.keys() & {"no_cloud", "touch_old"}:
            return
        for _ in range(2 if "twice" in self._active else 1):
            frame = self._source(0.0)
            points = frame.xyz.reshape(-1, 3)
            self.saved += 1
            suffix = "bak" if "another_name" in self._active else "ply"
            path = self._folder / f"cloud_{self.saved:04d}.{suffix}"
            write_ply(path.with_suffix(".writing"), points[np.isfinite(points).all(axis=1)], simulated=True)
            data = path.with_suffix(".writing").read_bytes()
            path.with_suffix(".writing").unlink()
            self._write(path, data)

    def _write(self, path: Path, data: bytes) -> None:
        if "empty" in self._active:
            path.touch()
        elif "half" in self._active:
            path.write_bytes(data[: len(data) // 2])
        elif wait_s := self._active.get("slowly"):
            with path.open("wb") as file:
                file.write(data[: len(data) // 2])
                file.flush()
                time.sleep(float(wait_s))
                file.write(data[len(data) // 2 :])
        else:
            path.write_bytes(data)
