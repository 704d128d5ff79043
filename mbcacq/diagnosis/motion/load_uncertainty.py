"""The load on a gear is itself an estimate: by how much it may be off."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbcacq.effects.motion.effect import OF_THE_DRIVE

if TYPE_CHECKING:
    from mbcacq.diagnosis.motion.forward_selection import ForwardSelection


def load_doubt(selection: ForwardSelection, chosen: np.ndarray, x: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """(J,) by what share the load may be off that winds up a gear: of the links' torque and of what effects add behind the gear, that part
    which goes with the load itself. chosen, x: what stands and its coefficients, spread: their covariance."""
    if selection.group.name != "tau":
        return np.zeros(len(selection.group.joints))
    out = []
    for place in range(len(selection.group.joints)):
        load, columns, at = _load(selection, place, chosen, x)
        present = selection.ledger.present(place)
        load = load - present * load.sum() / max(present.sum(), 1.0)
        share = load @ columns / max(float(load @ load), 1e-300)
        out.append(np.sqrt(max(float(share @ spread[np.ix_(at, at)] @ share), 0.0)))
    return np.array(out)


def _load(selection: ForwardSelection, place: int, chosen: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The torque that passes a gear (Ttot,), zero where a sample takes no part; the columns (Ttot, k) by which it was adapted, and where
    they stand in ``chosen``."""
    group, ledger = selection.group, selection.ledger
    behind = {int(i) for i in ledger.base[len(group.joints) : -selection.runs[0].q.shape[1]]}
    behind |= {int(i) for t in selection.taken if t.candidate.name not in OF_THE_DRIVE for i in t.variant.ids}
    columns, at = ledger.taking_part(place, chosen)
    mine = np.array([i for i, number in enumerate(chosen[at]) if int(number) in behind], dtype=int)
    rigid = np.concatenate([r.rigid[:, group.joints[place]] for r in selection.runs]) * ledger.present(place)
    return rigid + columns[:, mine] @ x[at[mine]], columns[:, mine], at[mine]
