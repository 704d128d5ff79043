"""FakeKrc: start, hurt and stop a fake controller."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.devices import signals_deferred
from mbcacq_fakes.protocols.faults import refuse_unknown
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.control import LOG_COLUMNS, Control
from mbcacq_fakes.protocols.krc.controller_process import ControllerProcess
from mbcacq_fakes.protocols.krc.settings import FAULTS, KrcSettings


class FakeKrc(ControllerProcess):
    """A KUKA controller with its RSI program running, in a process of its own, sending to ``client``.

    ``state``: an ArmState to publish the arm in, its name, or None for one of its own (``krc.state``). Everything else: see
    KrcSettings. ``FakeKrc(client=("127.0.0.1", port), realtime=False)`` runs as fast as its client answers.
    """

    def __init__(self, state: ArmState | str | None = None, *, bind: str = "127.0.0.1", **settings: Any) -> None:
        self.settings = KrcSettings(**settings)
        self._given, self._bind = state, bind
        self._control: Control | None = None
        self.state: ArmState | None = state if isinstance(state, ArmState) else None

    def _start(self) -> None:
        if self.state is None:
            name = self._given if isinstance(self._given, str) else ""
            with signals_deferred():
                self.state = ArmState.attach(name) if name else ArmState.create(tuple(np.radians(self.settings.start_deg)))
        with signals_deferred():
            control = self._control = Control.create(self.settings.log)
        control.set_faults(self.settings.faults)
        self._run("mbcacq_fakes.protocols.krc.process")
        start = {"settings": self.settings.to_json(), "state": self.state.name, "control": control.name, "bind": self._bind}
        self._ask(start)
        control.forget()

    def _release(self) -> None:
        if self._control is not None:
            self._control.close()
            self._control = None
        if self.state is not None and not isinstance(self._given, ArmState):
            self.state.close()
            self.state = None

    def inject(self, **faults: float) -> None:
        """Set faults while running, by name; 0 or False takes one back. See settings.FAULTS."""
        refuse_unknown(faults, FAULTS)
        self._running().set_faults(faults)

    def lead(self, target: np.ndarray) -> None:
        """A program on the controller, or a person, moves the arm to ``target`` (6,) rad."""
        self._running().lead(np.degrees(target).tolist())

    def counters(self) -> dict[str, int]:
        """cycles, sessions, answers, late, rejected, active, ended (index into arm_state.FAULTS)."""
        return self._running().counters()

    def log(self) -> dict[str, np.ndarray]:
        """What came and went, a row a cycle (needs ``log=True``): ipoc, latency_s, accepted, q (k, 6) deg, correction (k, 6) deg."""
        rows = np.array(self._running().read_log()).reshape(-1, len(LOG_COLUMNS))
        return {
            "ipoc": rows[:, 0].astype(np.int64),
            "latency_s": rows[:, 1],
            "accepted": rows[:, 2] != 0.0,
            "q": rows[:, 3:9],
            "correction": rows[:, 9:15],
        }

    def _running(self) -> Control:
        if self._control is None:
            raise RuntimeError("the fake controller does not run")
        return self._control
