"""An artefact as it really is: balls a little off their certificate, on rods above a dark plate on a tripod."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq_fakes.world.description import ArtefactFacts
from mbcacq_fakes.world.rigid import rigid


@dataclass(frozen=True)
class Carrier:
    """Carbon plate (frame and half sizes) and rods (R, 2, 3) from the plate to each ball, in the artefact's frame; mm."""

    plate: np.ndarray
    plate_half: np.ndarray
    rods: np.ndarray
    rod_radius: float
    tripod: np.ndarray
    tripod_radius: float = 15.0


@dataclass(frozen=True)
class TrueArtefact:
    id: str
    balls: tuple[int, ...]
    centres: np.ndarray
    radii: np.ndarray
    carrier: Carrier | None
    triangles: np.ndarray | None = None


def make(facts: ArtefactFacts, rng: np.random.Generator) -> TrueArtefact:
    """True centres are the certified ones plus a draw of their uncertainty."""
    centres = facts.centres + facts.uncertainty_mm * rng.standard_normal(facts.centres.shape)
    return TrueArtefact(facts.id, facts.balls, centres, facts.diameters / 2, carrier(facts) if facts.balls else None, facts.triangles)


def carrier(facts: ArtefactFacts, clearance: float = 12.0) -> Carrier:
    """A plate below the lowest ball; the scanner comes from the artefact's +z side."""
    radii = facts.diameters / 2
    low, high = facts.centres.min(axis=0), facts.centres.max(axis=0)
    floor = low[2] - radii.max() - clearance
    middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, floor])
    foot = facts.centres.copy()
    foot[:, 2] = floor
    return Carrier(
        plate=rigid(np.eye(3), middle),
        plate_half=(high - low)[:2] / 2 + radii.max() + 5.0,
        rods=np.stack([foot, facts.centres], axis=1),
        rod_radius=float(0.25 * radii.min()),
        tripod=np.stack([middle - [0, 0, 400.0], middle]),
    )
