"""Errors of the scanner over its field of view: field curvature, radial and depth-dependent bias."""

from collections.abc import Sequence

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, plain_effect
from mbcacq.effects.functions import ZERO, Column, DescribedPart, evaluate, monomial

NAME = "scanner_distortion"
DECLARED = Declaration(challenge=Challenge(number=12))
TYPICAL = 0.02  # mm at the edge of the field of view
# Biases that geometry and scanner_scale have already: they are tried only together with others.
ONLY_COMBINED = ("magnification", "depth_gain")
# A sphere of known radius is fitted to the visible cap, which the distortion bends too: that moves the centre by the next lower bias.
COMBINATIONS = (
    ("field_curvature_per_mm", "radial_per_mm2"),
    ("field_curvature_per_mm", "magnification"),
    ("depth_scale_per_mm", "magnification", "depth_gain"),
    ("radial_per_mm2", "field_curvature_per_mm", "magnification"),
    ("field_curvature_per_mm", "depth_scale_per_mm", "magnification", "depth_gain"),
)
# Name of the coefficient -> the covariate that shows the bias best, and the bias along x, y and z by the place in the field of view.
BIASES: dict[str, tuple[str, tuple[Column, Column, Column]]] = {
    "field_curvature_per_mm": ("x", (ZERO, ZERO, (monomial(x=2), monomial(y=2)))),
    "radial_per_mm2": ("x", ((monomial(x=3), monomial(x=1, y=2)), (monomial(x=2, y=1), monomial(y=3)), ZERO)),
    "depth_scale_per_mm": ("z", ((monomial(x=1, z=1),), (monomial(y=1, z=1),), ZERO)),
    "depth_quadratic_per_mm": ("z", (ZERO, ZERO, (monomial(z=2),))),
    "astigmatism_per_mm": ("x", (ZERO, ZERO, (monomial(x=2), monomial(-1.0, y=2)))),
    "saddle_per_mm": ("x", (ZERO, ZERO, (monomial(x=1, y=1),))),
    "magnification": ("x", ((monomial(x=1),), (monomial(y=1),), ZERO)),
    "depth_gain": ("z", (ZERO, ZERO, (monomial(z=1),))),
}


def candidates(context: Context) -> list[Candidate]:
    """Each bias by itself, and the combinations that a distortion of the surface makes of the centres."""
    if not context.scanner_on_flange or np.ptp(context.obs.xyz, axis=0).max() == 0:
        raise Missing("no field of view: the measured points are all at one place, or not a scanner's")

    def combined(names: Sequence[str]) -> Candidate:
        parts = [DescribedPart("point", 0, c, tuple(BIASES[k][1][c] for k in names)) for c in range(3)]
        bias = np.stack([evaluate(part.columns, context.value, context.obs.n_centres) for part in parts], axis=1)
        typical = TYPICAL / np.maximum(np.linalg.norm(bias, axis=1).max(axis=0), 1e-12)
        sizes = dict(zip(names, typical, strict=True))
        return plain_effect(NAME, ["scanner"], BIASES[names[0]][0], parts, sizes, variant="+".join(names))

    alone = [k for k in BIASES if k not in ONLY_COMBINED]
    return [combined([k]) for k in alone] + [combined(names) for names in COMBINATIONS]
