"""The fake EKI controller, for tests and for the fake cell: starts its process, hurts it, asks it."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from mbcacq.devices import signals_deferred
from mbcacq_fakes.protocols.faults import refuse_unknown
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.controller_process import ControllerProcess
from mbcacq_fakes.protocols.krc.eki_settings import FAULTS, EkiSettings


class FakeEkiController(ControllerProcess):
    """A KUKA controller that runs KRL programs given as text, behind an EKI channel given as XML, in a process of its own.

    ``state``: an ArmState to publish the arm in, or None for one of its own. Everything else: see EkiSettings.
    """

    def __init__(self, state: ArmState | None = None, **settings: Any) -> None:
        self.settings = EkiSettings(**settings)
        self._given = self.state = state
        self._lock = threading.Lock()
        self.port = self.settings.port

    def _start(self) -> None:
        if self.state is None:
            with signals_deferred():
                self.state = ArmState.create(tuple(np.radians(self.settings.start_deg)))
        self._run("mbcacq_fakes.protocols.krc.eki_process")
        answer = self._exchange({"settings": self.settings.to_json(), "state": self.state.name})
        if "error" in answer:
            raise RuntimeError(f"the fake controller did not start: {answer['error']}")
        self.port = answer["port"]

    def _release(self) -> None:
        if self.state is not None and self._given is None:
            self.state.close()
            self.state = None

    def inject(self, **faults: float) -> None:
        """Set faults while running, by name; 0 or False takes one back. See eki_settings.FAULTS."""
        refuse_unknown(faults, FAULTS)
        self._exchange({"faults": {name: float(value) for name, value in faults.items()}})

    def lead(self, target: np.ndarray) -> None:
        """A person moves the arm to ``target`` (6,) rad, while our program does not run."""
        self._exchange({"lead": np.degrees(target).tolist()})

    def report(self) -> dict[str, Any]:
        """The program's variables, the channel's counts, the last message."""
        return self._exchange({"ask": True})

    def _exchange(self, message: dict[str, Any]) -> dict[str, Any]:
        with self._lock:
            return self._ask(message)
