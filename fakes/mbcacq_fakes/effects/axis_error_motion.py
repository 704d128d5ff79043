"""Rails that sag between their supports, and a bearing whose raceways are not round: what an external axis carries leaves its line."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class AxisErrorMotion(InjectedEffect):
    """A slide shifts across and turns with waves as long as the distance of its supports, a table some times a turn."""

    options = {"where": "E1", "shift_mm": None, "tilt_rad": None, "wave_mm": 2500.0, "lobes": 2}

    def draw(self) -> dict[str, Any]:
        (self._axis_number,) = self.axes([])
        if self.cell.slides is None and not self.cell.axes[self._axis_number].startswith("E"):
            raise ConfigError(f"fake.hidden: {self.name} acts at external axes and slides; name one, such as E1")
        self.shift = self.size(0.1) if self.given["shift_mm"] is None else float(self.given["shift_mm"])
        self.tilt = self.size(1e-4) if self.given["tilt_rad"] is None else float(self.given["tilt_rad"])
        self.phase = float(self.rng.uniform(-np.pi, np.pi))
        return {"where": self.names([self._axis_number]), "shift_mm": self.shift, "tilt_rad": self.tilt, "phase_rad": self.phase}

    def displace(self, at: Moments, moved: Moved) -> None:
        i = self._axis_number
        frames = self.arm.frames(at.q)
        into = np.swapaxes(frames[:, i + 1, :3, :3], 1, 2) @ frames[:, i, :3, :3]  # from the housing into what is carried
        slides = self.cell.slides is not None and bool(self.cell.slides[i])
        u = self.phase + (2 * np.pi / self.given["wave_mm"] if slides else self.given["lobes"]) * at.q[:, i]
        across = np.stack([np.cos(u), np.zeros(len(at)) if slides else np.sin(u), np.zeros(len(at))], axis=1)
        moved.frame[:, i + 1, :3] += self.shift * np.einsum("pij,pj->pi", into, across)
        moved.frame[:, i + 1, 3:] += self.tilt * np.einsum("pij,pj->pi", into, np.roll(across, 1, axis=1) if slides else across)
