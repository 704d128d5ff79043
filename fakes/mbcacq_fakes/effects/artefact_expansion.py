"""An artefact that is not at its reference temperature, or made of something else than its certificate says."""

from __future__ import annotations

from typing import Any

from mbcacq.errors import ConfigError
from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class ArtefactExpansion(InjectedEffect):
    options = {"artefact": None, "scale_ppm": None}

    def draw(self) -> dict[str, Any]:
        ids = [a.id for a in self.cell.artefacts]
        artefact = self.given["artefact"] or ids[0]
        if artefact not in ids:
            raise ConfigError(f"fake.hidden: artefact_expansion: there is no artefact '{artefact}'; correct the plan")
        index = ids.index(artefact)
        before = sum(len(a.balls) for a in self.cell.artefacts[:index])
        self._id, self._balls = artefact, slice(before, before + len(self.cell.artefacts[index].balls))
        self._centres = self.cell.artefacts[index].centres
        given = self.given["scale_ppm"]
        self.scale = self.size(6e-4) if given is None else float(given) * 1e-6
        return {"where": [self._id], "scale_ppm": self.scale * 1e6}

    def displace(self, at: Moments, moved: Moved) -> None:
        moved.ball[:, self._balls] += self.scale * self._centres
