"""Effects that are linear in their coefficients: what they displace, and the derivative of the prediction by each coefficient.

A term says where it acts and with which functions of the covariates; everything else (displacements for the forward model,
design matrix for a solver) follows from the few locations at which an effect can act.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.forward_model import Displacements, Prediction, arm_jacobian, ball_jacobian, station_jacobian
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations

PLACES = ("joint", "frame", "point", "ball", "station", "orientation")
PER_POSE = ("joint", "frame", "station")


@dataclass(frozen=True)
class Part:
    """Movement of one component of one place by ``basis @ coefficients``.

    place: 'joint' (index 0..n-1, component 0; rad); 'frame' (index 0 behind the base, i behind link i, n the mount; component
    0..5 of the local twist, mm and rad); 'station' (component 0..5 of the local twist of the pose's own station); 'point'
    (component 0..2, mm added to the measured point in the scanner frame); 'orientation' (component 0..2, rad by which the measured
    orientation of a target is turned about the target's own axes); 'ball' (component 0..2, mm in the artefact frame).
    basis: (P, k) for joint, frame, station; (M, k) for point, orientation and ball.
    """

    place: str
    index: int
    component: int
    basis: np.ndarray


@dataclass(frozen=True)
class Term:
    """Parts that share k coefficients. names, units: one per coefficient; sigma: (k,) prior standard deviation, inf = none."""

    name: str
    parts: tuple[Part, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    sigma: np.ndarray

    @property
    def size(self) -> int:
        return len(self.names)


def term(
    name: str,
    parts: Sequence[Part],
    names: Sequence[str] | None = None,
    units: Sequence[str] | str = "",
    sigma: np.ndarray | float = np.inf,
) -> Term:
    """A ``Term`` with its shapes checked; names default to NAME or NAME[j]. Raises ValueError where shapes disagree."""
    k = {part.basis.shape[1] for part in parts}
    if len(k) != 1:
        raise ValueError(f"term {name}: its parts have different numbers of coefficients {sorted(k)}")
    size = k.pop()
    if unknown := {part.place for part in parts} - set(PLACES):
        raise ValueError(f"term {name}: no such place: {', '.join(sorted(unknown))}")
    given = tuple(names) if names is not None else ((name,) if size == 1 else tuple(f"{name}[{j}]" for j in range(size)))
    unit = (units,) * size if isinstance(units, str) else tuple(units)
    if len(given) != size or len(unit) != size:
        raise ValueError(f"term {name}: {size} coefficients, but {len(given)} names and {len(unit)} units")
    return Term(name, tuple(parts), given, unit, np.broadcast_to(np.asarray(sigma, dtype=float), (size,)).copy())


def columns(observations: Observations, prediction: Prediction, term: Term) -> np.ndarray:
    """Derivative of the prediction by the term's coefficients: (M, R, k).

    ``prediction`` should include the displacements at which to linearise; second order in a displacement's rotation is left out.
    """
    obs = observations
    twists = np.zeros((obs.n_poses, term.size, 6))
    local = np.zeros((obs.n_poses, term.size, 6))
    out = np.zeros((*prediction.gradient.shape[:2], term.size))
    for part in term.parts:
        _check_rows(obs, term, part)
        if part.place == "joint":
            axis = obs.cell.robot.chain.joint_twists(prediction.frames)[:, part.index]
            twists += axis[:, None, :] * part.basis[:, :, None]
        elif part.place == "frame":
            direction = se3.adjoint(prediction.frames[:, part.index])[:, :, part.component]
            twists += direction[:, None, :] * part.basis[:, :, None]
        elif part.place == "station":
            local[:, :, part.component] += part.basis
        elif part.place == "point":
            out[:, part.component] += part.basis
        elif part.place == "orientation":
            if prediction.rotation is not None:  # where none is measured there is nothing to turn
                out[:, 3:] += prediction.rotation[:, :, part.component, None] * part.basis[:, None, :]
        else:
            out[:, :3] += ball_jacobian(obs, prediction)[:, :, part.component, None] * part.basis[:, None, :]
    if any(part.place in ("joint", "frame") for part in term.parts):
        out += arm_jacobian(obs, prediction, twists)
    if any(part.place == "station" for part in term.parts):
        out += station_jacobian(obs, prediction) @ np.swapaxes(local, -1, -2)[obs.pose]
    return out


def accumulate(observations: Observations, terms: Sequence[Term], coefficients: Sequence[np.ndarray]) -> Displacements:
    """What the terms together do to the cell; coefficients: one (k,) array per term."""
    obs, n = observations, observations.cell.robot.n
    shapes = {
        "joint": (obs.n_poses, n),
        "frame": (obs.n_poses, n + 1, 6),
        "station": (obs.n_poses, 6),
        "point": (obs.n_centres, 3),
        "ball": (obs.n_centres, 3),
        "orientation": (obs.n_centres, 3),
    }
    total: dict[str, np.ndarray] = {}
    for one, values in zip(terms, coefficients, strict=True):
        for part in one.parts:
            _check_rows(obs, one, part)
            array = total.setdefault(part.place, np.zeros(shapes[part.place]))
            amount = part.basis @ np.asarray(values)
            if part.place == "joint":
                array[:, part.index] += amount
            elif part.place == "frame":
                array[:, part.index, part.component] += amount
            else:
                array[:, part.component] += amount
    return Displacements(**total)


def _check_rows(obs: Observations, term: Term, part: Part) -> None:
    rows = obs.n_poses if part.place in PER_POSE else obs.n_centres
    if len(part.basis) != rows:
        raise ValueError(f"term {term.name}: the basis at {part.place} has {len(part.basis)} rows, expected {rows}")
