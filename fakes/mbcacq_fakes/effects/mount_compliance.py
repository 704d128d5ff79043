"""The scanner's bracket as a short cantilever: it bends and shifts with its attitude to gravity."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.arm import STANDARD_GRAVITY
from mbcacq_fakes.world.hooks import Moments, Moved


class MountCompliance(InjectedEffect):
    options = {"kind": None}

    def draw(self) -> dict[str, Any]:
        kind = self.given["kind"] or self.rng.choice(["tilt", "shift", "both"])
        masses = self.cell.masses
        # Without a known tool: a scanner of 1.5 kg half way to its measuring volume.
        self.mass = masses.payload_mass if masses.payload_mass > 0 else 1.0
        self.com = masses.payload_com if np.any(masses.payload_com) else self.cell.hand_eye[:3, 3] / 2
        weight = self.mass * STANDARD_GRAVITY
        self.tilt = 0.0 if kind == "shift" else abs(self.size(3e-4 / max(weight * float(np.linalg.norm(self.com)) * 1e-3, 0.05)))
        self.shift = 0.0 if kind == "tilt" else abs(self.size(0.06 / weight))
        return {"where": ["mount"], "compliance_rad_per_Nm": self.tilt, "compliance_mm_per_N": self.shift}

    def displace(self, at: Moments, moved: Moved) -> None:
        flange = self.arm.flange(at.q + moved.joint)
        # As a row vector times R: gravity in the flange frame.
        force = self.mass * STANDARD_GRAVITY * np.einsum("c,pcd->pd", self.cell.masses.gravity, flange[:, :3, :3])
        moved.frame[:, -1, :3] += self.shift * force
        moved.frame[:, -1, 3:] += self.tilt * np.cross(self.com, force) * 1e-3
