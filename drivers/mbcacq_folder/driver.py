"""``driver: folder``: triggers a scanner's own program and takes the cloud that it saves, once it is written whole."""

from __future__ import annotations

import fnmatch
import hashlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.devices import (
    Aborted,
    ConfigError,
    ConnectError,
    ContextDevice,
    Description,
    DeviceFault,
    DeviceTimeout,
    Fact,
    Field,
    Scan,
    parse_options,
)
from mbcacq_folder.options import FolderOptions
from mbcacq_folder.trigger import POLL_S, CloudTrigger

Written = tuple[int, int]  # size, time of the last change in ns


class FolderScanner(ContextDevice):
    """Implements mbcacq.devices.Scanner. Options: see FolderOptions.

    A file that stood in the folder before the trigger, unchanged, is never taken: an old cloud cannot pass for a new one.
    """

    plan_facts = ("cloud_reader",)
    verified_on_hardware = False

    first_contact = (
        "The scanner's program saves a cloud into the folder by hand: note its name, size and how long it takes to be written.",
        "The trigger alone makes it save one cloud; note what it answers.",
        "The balls of that cloud are round and of the certified diameter: unit and axes are right, z points to the scanner.",
        "Trigger while the program is closed: the run ends with a sentence that names it.",
    )

    def __init__(self, name: str, model: str, options: Mapping[str, Any]) -> None:
        self._name, self._model, self._options = name, model, parse_options(FolderOptions, f"scanner '{name}'", options, ("read_cloud",))
        self._stop, self._connected, self._count = threading.Event(), False, 0
        self._facts: tuple[Fact, ...] = ()
        self._trigger = CloudTrigger(name, self._options.trigger, self._options.connect_timeout_s, self._stop.is_set)

    def use_outputs(self, set_output: Callable[[int, bool], None] | None, numbers: Sequence[int]) -> None:
        """The robot's ``set_output(number, value)``, or None if its driver switches none, and which it may switch. Raises ConfigError
        where another one is needed."""
        self._trigger.use_outputs(set_output, numbers)

    def describe(self) -> Description:
        o = self._options
        return Description(
            "scanner",
            self._model or "a program that saves clouds",
            (Field("points", "mm", (3,), meaning="in the scanner frame"),),
            settings={"folder": str(o.folder), "pattern": o.pattern, "unit": o.unit or "as the clouds say, or mm", "axes": o.axes},
        )

    def connect(self) -> None:
        """Raises ConnectError if there is no such folder, or nobody to trigger; ConfigError without a reader of clouds."""
        self.close()
        self._stop.clear()
        if self._options.read_cloud is None:
            raise ConfigError(f"scanner '{self._name}': nobody reads its clouds; create it by mbcacq, which hands it a reader")
        if not self._options.folder.is_dir():
            raise ConnectError(f"scanner '{self._name}': there is no folder {self._options.folder}; create it, or correct the plan")
        self._facts = self._read_facts()
        self._trigger.check()
        self._connected = True

    def facts(self) -> tuple[Fact, ...]:
        """The content of each watched file at the last cloud, by a digest."""
        return self._facts

    def _read_facts(self) -> tuple[Fact, ...]:
        try:
            return tuple(Fact(str(path), hashlib.sha256(path.read_bytes()).hexdigest()[:8]) for path in self._options.watched)
        except OSError as error:
            raise ConnectError(f"scanner '{self._name}': {error.filename}, which it watches: {error.strerror}; bring it back") from error

    def capture(self, exposure_us: float | None = None) -> Scan:
        """CloudTrigger, wait for a new cloud, read it. The exposure is the program's own; ``exposure_us`` is not used.

        Raises ConnectError, DeviceTimeout if no new cloud was written whole in time, DeviceFault for one that cannot be read,
        ProtocolError for another reply to the trigger, Aborted after ``stop``.
        """
        if not self._connected:
            raise ConnectError(f"scanner '{self._name}' is not connected; connect it first")
        self._stop.clear()
        before, deadline = self._files(), time.monotonic() + self._options.timeout_s
        self._trigger.fire(deadline)
        path, points, others = self._await(before, deadline)
        self._count, self._facts = self._count + 1, self._read_facts()
        warnings = ()
        if others:
            warnings = (f"{len(others) + 1} new clouds stand in the folder after one trigger ({', '.join(others)}); {path.name} was taken",)
        return Scan(np.ascontiguousarray(points, dtype=np.float32), time_s=path.stat().st_mtime, frame=self._count, warnings=warnings)

    def stop(self) -> None:
        """End a wait for a cloud."""
        self._stop.set()

    def close(self) -> None:
        self.stop()
        self._connected = False

    def _files(self) -> dict[Path, Written]:
        """Every file of the pattern, with what says whether it changes. Raises ConnectError if the folder is gone."""
        out: dict[Path, Written] = {}
        try:
            for path in self._options.folder.iterdir():
                if fnmatch.fnmatch(path.name.lower(), self._options.pattern.lower()) and path.is_file():
                    about = path.stat()
                    out[path] = (about.st_size, about.st_mtime_ns)
        except FileNotFoundError:
            if not self._options.folder.is_dir():
                raise ConnectError(
                    f"scanner '{self._name}': the folder {self._options.folder} is gone; is the share still there?"
                ) from None
        except OSError as error:
            raise ConnectError(f"scanner '{self._name}': {self._options.folder}: {error.strerror}; is the share still there?") from error
        return out

    def _await(self, before: dict[Path, Written], deadline: float) -> tuple[Path, np.ndarray, list[str]]:
        """The first new cloud that is whole, its points, and the names of others. Raises as ``capture``."""
        last: dict[Path, Written] = {}
        quiet_since: dict[Path, float] = {}
        why: dict[Path, str] = {}
        while True:
            now = time.monotonic()
            new = {path: written for path, written in self._files().items() if before.get(path) != written}
            for path, written in new.items():
                if last.get(path) != written:
                    quiet_since[path] = now
            last = new
            for path in sorted(new, key=lambda p: (new[p][1], p.name)):
                if now - quiet_since[path] >= self._options.quiet_s and new[path][0] > 0:
                    try:
                        points = self._options.read_cloud(path)
                    except ConfigError as error:
                        why[path] = str(error)  # perhaps it is only half written yet
                        continue
                    return path, points, [other.name for other in new if other != path]
            if now > deadline:
                raise self._too_late(new, why)
            if self._stop.wait(POLL_S):
                raise Aborted("the wait for the scanner was ended")

    def _too_late(self, new: dict[Path, Written], why: dict[Path, str]) -> DeviceFault | DeviceTimeout:
        if why:
            return DeviceFault(f"scanner '{self._name}': {next(iter(why.values()))}")
        what = (
            f"{next(iter(new)).name} is still being written" if new else f"no new cloud ({self._options.pattern}) in {self._options.folder}"
        )
        return DeviceTimeout(
            f"scanner '{self._name}': {what} {self._options.timeout_s:g} s after the trigger; does the program save there, so named?"
        )
