"""The program: one TCP server, one folder. It answers OK and saves ``cloud_0001.ply``, ``cloud_0002.ply``..."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

import numpy as np

from mbcacq.recording.datasets.scan_folder import write_ply
from mbcacq_fakes.protocols.faults import Faults
from mbcacq_fakes.protocols.tcp_server import TcpServer
from mbcacq_fakes.world.frame import ScannerFrame

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


class FakeScannerProgram(TcpServer):
    """Context manager. source: a frame for an exposure; folder: where its clouds go. rises: how often the output of a robot that triggers
    it was switched on so far, or None."""

    def __init__(self, source: Callable[[float], ScannerFrame], folder: Path, rises: Callable[[], int] | None = None) -> None:
        super().__init__()
        self._source, self._folder, self._rises = source, folder, rises
        self.faults = Faults(FAULTS)
        self.saved = 0

    def start(self) -> Self:
        """A wire from the robot may stand in place of the network."""
        if self._rises is None:
            return super().start()
        self._wire = threading.Thread(target=self._watch, args=(self._rises,), name="fake-scanner-program", daemon=True)
        self._wire.start()
        return self

    def _watch(self, rises: Callable[[], int]) -> None:
        seen = rises()
        while not self._quit.wait(WATCH_S):
            if (now := rises()) != seen:
                seen = now
                self._save()

    def talk(self, connection: socket.socket) -> None:
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
                if word.strip() == b"trigger" and not self.faults.get("silent"):
                    connection.sendall(b"BUSY\n" if self.faults.get("refused") else b"OK\n")
                    if not self.faults.get("refused"):
                        self._save()

    def _save(self) -> None:
        if self.faults.get("no_cloud") or self.faults.get("touch_old"):
            return
        count = 2 if self.faults.get("twice") else 1  # two stand there at once, however slow the disk is
        for path in [self._written_aside() for _ in range(count)]:
            self._put(path.with_suffix(".bak" if self.faults.get("another_name") else ".ply"), path)

    def _written_aside(self) -> Path:
        points = self._source(0.0).xyz.reshape(-1, 3)
        self.saved += 1
        path = self._folder / f"cloud_{self.saved:04d}.writing"
        write_ply(path, points[np.isfinite(points).all(axis=1)], simulated=True)
        return path

    def _put(self, path: Path, aside: Path) -> None:
        if self.faults.get("twice"):
            aside.replace(path)
            return
        data = aside.read_bytes()
        aside.unlink()
        if self.faults.get("empty"):
            path.touch()
        elif self.faults.get("half"):
            path.write_bytes(data[: len(data) // 2])
        elif wait_s := self.faults.get("slowly"):
            with path.open("wb") as file:
                file.write(data[: len(data) // 2])
                file.flush()
                time.sleep(float(wait_s))
                file.write(data[len(data) // 2 :])
        else:
            path.write_bytes(data)
