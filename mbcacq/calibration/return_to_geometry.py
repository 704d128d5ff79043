"""Beyond where an unmodelled function of angles was learnt, a cell is what the recording gives without the function.

Function and geometry share what a recording shows: an arm that was fitted beside a function is wrong without it. So such functions are kept
with a term that grows beyond their ranges: the change to the cell that was fitted without them (benchmarks/third.md). The functions' own
covariance goes on, and the change counts as an uncertainty: both together are the expected square of the error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import BEYOND, UNKNOWN, EffectTerm
from mbcacq.effects.functions import DescribedPart, Product
from mbcacq.effects.learnt_range import is_angle
from mbcacq.geometry import se3

Place = tuple[str, int, int]


def returning_to_geometry(cell: CalibratedCell, without: CalibratedCell, named: EffectModel) -> CalibratedCell:
    """The same cell where its unmodelled functions of angles were learnt; beyond, the one without them.

    named: the effects of the latter.
    """
    model = cell.effects
    unmodelled = [t for t in model.terms if t.name == UNKNOWN and 1 <= len(t.covariates) <= 2] if model else []
    ending = [t for t in unmodelled if all(map(is_angle, t.covariates))]
    if model is None or not ending:
        return cell
    changes = list(_changes(cell, without, named, ending))
    parts = [DescribedPart(*place, (tuple(p for at, p in changes if at == place),)) for place in dict.fromkeys(at for at, _ in changes)]
    where = tuple(dict.fromkeys(at for t in ending for at in t.where))
    angles = "*".join(sorted({name for t in ending for name in t.covariates}))
    going_on = {name for t in ending for name in t.covariates - set(t.clamped)}
    held = tuple(sorted({name for t in (*named.terms, *ending) for name in t.clamped} - going_on))
    here = Covariates(cell.fit.observations)
    change = EffectTerm.of_group(here, where, angles, parts, np.ones(1), ("",), BEYOND, clamped=held)
    return replace(cell, effects=replace(model, terms=(*model.terms, replace(change, coefficients=np.ones(1)))))


def _changes(
    cell: CalibratedCell, without: CalibratedCell, named: EffectModel, ending: Sequence[EffectTerm]
) -> Iterator[tuple[Place, Product]]:
    """What moves from one cell to the other: effects, and the frames of the arm."""
    now = {t.key: t.coefficients for t in cell.effects.terms} if cell.effects else {}
    changed = [(t, t.coefficients - now[t.key]) for t in named.terms] + [(t, -t.coefficients) for t in ending]
    for t, change in changed:
        for part in t.parts:
            for by, column in zip(change, part.columns, strict=True):
                for p in column:
                    yield (part.place, part.index, part.component), Product(float(by) * p.factor, p.functions)
    state, other = cell.state, without.state
    at_rest = np.zeros((1, state.chain.n))
    root = state.chain.frames(at_rest)[0, 0]
    base = state.T_base_station @ se3.inverse(other.T_base_station)  # it moves instead of the stations
    links = [chain.link_transforms(at_rest)[0] for chain in (state.chain, other.chain)]
    moved = [se3.inverse(root) @ base @ root, *(se3.inverse(links[0]) @ links[1])]
    moved[-1] = moved[-1] @ other.T_flange_scanner @ se3.inverse(state.T_flange_scanner)
    for frame, motion in enumerate(moved):
        for component, twist in enumerate(se3.coordinates(motion).reshape(-1, 6).mean(axis=0)):
            if twist:
                yield ("frame", frame, component), Product(float(twist))
