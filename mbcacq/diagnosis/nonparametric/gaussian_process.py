"""Richer descriptions of an unmodelled effect whose location is known: a Gaussian process of one covariate, or of two angles together.

A process with a Matern kernel is a random effect of the kernel's eigenfunctions at the poses, with prior variances that are its
eigenvalues. Its length is one of a few; which, and of which covariates, is decided by evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.spatial.distance import cdist

from mbcacq.diagnosis.nonparametric.basis_functions import BasisFunction, BasisTable
from mbcacq.diagnosis.nonparametric.design_blocks import BlockGroup, GivenBlocks
from mbcacq.diagnosis.nonparametric.locations import Location
from mbcacq.effects.context import Context
from mbcacq.effects.effect_term import is_angle

LENGTHS = (0.2, 0.4, 0.8)  # rad, or of the largest moment: from a local bump to what few harmonics nearly are
COMPARED = 30  # functions of each process, while these are compared
MOST_FUNCTIONS = 90  # of the one chosen: what fewer leave of it would be taken for noise of the joints
SMALLEST = 1e-4  # variance of a function, in those of the first, that is left out


@dataclass(frozen=True)
class Process:
    """x (P, d): a covariate, or it and another together; depends_on: the covariate, for the report. length: of the kernel, in units of x.

    label: tells processes at one location apart.
    """

    depends_on: str
    label: str
    x: np.ndarray
    length: float


def processes(s: Context, location: Location, depends_on: str) -> list[Process]:
    """Processes at a location where something was found to depend on a covariate: of an angle, of it together with that of either
    neighbouring joint, and of the gravity moment, whole and by its components.
    """
    out, angle = list[tuple[str, str, np.ndarray]](), s.obs.q
    if is_angle(depends_on):
        own = int(depends_on[1:]) - 1
        for joints in ([own], [own - 1, own], [own, own + 1]):
            if min(joints) >= 0 and max(joints) < s.n and np.ptp(angle[:, joints], axis=0).min() > 0.02:
                out.append((depends_on, "+".join(f"q{j + 1}" for j in joints), angle[:, joints]))
    elif not depends_on.startswith("gravity_torque_"):
        return []
    moment = s.gravity_moment(location.frame)
    moment = moment / max(float(np.linalg.norm(moment, axis=1).max()), 1e-12)
    moment = moment[:, np.ptp(moment, axis=0) > 0.02]
    name = f"gravity_torque_{min(max(location.frame + 1, 2), s.n)}"
    out += [(name, f"moment {j}", moment[:, [j]]) for j in range(moment.shape[1])]
    out += [(name, "moment", moment)] if moment.shape[1] > 1 else []
    return [Process(on, f"{label} {length}", x, length) for on, label, x in out for length in LENGTHS]


def eigenfunctions(x: np.ndarray, length: float, most: int) -> tuple[np.ndarray, np.ndarray]:
    """(P, f) of a Matern kernel (5/2) at x (P, d), without their mean over the poses, and the variance (f,) of each, largest first."""
    near = np.sqrt(5.0) * cdist(x, x) / length
    kernel = (1.0 + near + near**2 / 3.0) * np.exp(-near)
    kernel = kernel - kernel.mean(axis=0)
    kernel = kernel - kernel.mean(axis=1, keepdims=True)
    variance, functions = eigh(kernel, subset_by_index=[max(len(x) - most, 1), len(x) - 1])
    kept = variance > SMALLEST * variance[-1]
    return functions[:, kept][:, ::-1], variance[kept][::-1]


def blocks(location: Location, chosen: Sequence[Process], variants: Iterable[tuple[int, ...]], most: int) -> GivenBlocks:
    """Each process, of at most so many functions, for some choices of a location's components; one after the other."""
    table = BasisTable()
    for process in chosen:
        functions, variance = eigenfunctions(process.x, process.length, most)
        table.shapes.append(BasisFunction(process.depends_on, table.add(functions), np.sqrt(variance / variance[0])))
    entries = [(location.name, rows, shape) for rows in variants for shape in table.shapes]
    return GivenBlocks([BlockGroup(len(location.mix), table.values, entries, location.keys, location.mix, True)])
