"""The two fake controllers of KUKA, for tests and for the fake cell: start, hurt, ask and stop them."""

from __future__ import annotations

from base64 import b64decode
from typing import Any

import numpy as np

from mbcacq_fakes.protocols.krc import eki_settings, settings
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.controller_process import ControllerProcess

LOG_COLUMNS = 15  # ipoc, latency_s, accepted, six of q, six of the correction


class FakeKrc(ControllerProcess):
    """A KUKA controller with its RSI program running, in a process of its own, sending to ``client``.

    Settings: see KrcSettings. ``FakeKrc(client=("127.0.0.1", port), realtime=False)`` runs as fast as its client answers. ``report``:
    cycles, sessions, answers, late, rejected, active, ended (index into arm_state.FAULTS).
    """

    module, known_faults = "mbcacq_fakes.protocols.krc.process", settings.FAULTS

    def __init__(self, state: ArmState | None = None, **given: Any) -> None:
        super().__init__(settings.KrcSettings(**given), state)

    def log(self) -> dict[str, np.ndarray]:
        """What came and went, a row a cycle (needs ``log=True``): ipoc, latency_s, accepted, q (k, 6) deg, correction (k, 6) deg."""
        rows = np.frombuffer(b64decode(self._ask(log=True)["log"])).reshape(-1, LOG_COLUMNS)
        return {
            "ipoc": rows[:, 0].astype(np.int64),
            "latency_s": rows[:, 1],
            "accepted": rows[:, 2] != 0.0,
            "q": rows[:, 3:9],
            "correction": rows[:, 9:15],
        }


class FakeEkiController(ControllerProcess):
    """A KUKA controller that runs KRL programs given as text, behind an EKI channel given as XML, in a process of its own.

    Settings: see EkiSettings. ``report``: the program's variables, the channel's counts, the last message.
    """

    module, known_faults = "mbcacq_fakes.protocols.krc.eki_process", eki_settings.FAULTS

    def __init__(self, state: ArmState | None = None, **given: Any) -> None:
        super().__init__(eki_settings.EkiSettings(**given), state)
