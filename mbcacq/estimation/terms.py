"""Effects that are linear in their coefficients: what they displace, and the derivative of the prediction by each coefficient.

A term says where it acts and with which functions of the covariates; everything else (displacements for the forward model,
design matrix for a solver) follows from the few locations at which an effect can act.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.estimation.forward_model import Displacements, Prediction
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

    def at_poses(self, poses: np.ndarray, pose: np.ndarray) -> Term:
        """The term at some poses (P,) bool of the recording; pose: (M,) of its centres."""
        return replace(self, parts=at_poses(self.parts, poses, pose))


LENGTH, LENGTH_NAMES = "length", ("length.offset", "length.scale")
SHARED = "unknown:shared"  # as all coefficients that mean nothing by themselves


def shared_errors(obs: Observations) -> tuple[Term, ...]:
    """The errors that all measurements of a recording share, as one term of coefficients of variance 1; () without any."""
    if obs.shared is None or not obs.shared.size:
        return ()
    parts = [Part("point", 0, c, obs.shared[:, c]) for c in range(3)]
    if obs.rotation is not None:  # about the instrument's axes, where a part turns about the target's own
        own = np.swapaxes(obs.rotation, 1, 2) @ obs.shared[:, 3:]
        parts += [Part("orientation", 0, c, own[:, c]) for c in range(3)]
    return (term(SHARED, parts, [f"{SHARED}_{k + 1}" for k in range(obs.shared.shape[2])], sigma=1.0),)


def length_errors(obs: Observations) -> tuple[Term, ...]:
    """Offset (mm) and scale of an instrument that measures distances alone; () for any other."""
    if not obs.cell.length_scale:
        return ()
    part = Part("point", 0, 0, np.stack([np.ones(obs.n_centres), obs.xyz[:, 0]], axis=1))
    return (term(LENGTH, [part], LENGTH_NAMES, ("mm", ""), np.array([np.inf, obs.cell.length_scale])),)


def own_errors(obs: Observations) -> tuple[Term, ...]:
    """The errors of the instrument that belong to a recording alone, and are estimated with its cell."""
    return (*shared_errors(obs), *length_errors(obs))


def known_errors(obs: Observations, values: Mapping[str, float]) -> list[tuple[Term, np.ndarray]]:
    """The terms among these whose coefficients are known by their names, with them."""
    return [(t, np.array([values[n] for n in t.names])) for t in own_errors(obs) if all(n in values for n in t.names)]


def at_poses(parts: Sequence[Part], poses: np.ndarray, pose: np.ndarray) -> tuple[Part, ...]:
    """Parts at some poses (P,) bool of a recording; pose: (M,) of its centres."""
    return tuple(replace(p, basis=p.basis[poses if p.place in PER_POSE else poses[pose]]) for p in parts)


def term(
    name: str,
    parts: Sequence[Part],
    names: Sequence[str] | None = None,
    units: Sequence[str] | str = "",
    sigma: np.ndarray | float = np.inf,
) -> Term:
    """A ``Term`` with its shapes checked; names default to NAME or NAME[j]. Raises ValueError if shapes disagree."""
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


def columns(obs: Observations, prediction: Prediction, term: Term) -> np.ndarray:
    """Derivative of the prediction by the term's coefficients: (M, R, k).

    ``prediction`` should include the displacements at which to linearise; second order in a displacement's rotation is left out.
    """
    total = np.zeros(())
    for part in term.parts:
        _check_rows(obs, term, part)
        # All functions move a centre in one direction: a product a row and function, not one for each component of the twist.
        basis = part.basis[obs.pose] if part.place in PER_POSE else part.basis
        total = total + unit(obs, prediction, part.place, part.index, part.component)[:, :, None] * basis[:, None, :]
    return total


def unit(obs: Observations, prediction: Prediction, place: str, index: int, component: int) -> np.ndarray:
    """(M, R): change of the prediction by a unit of one component of one place."""
    if place in PER_POSE:
        return np.einsum("mrc,mc->mr", prediction.gradient, unit_twist(obs, prediction, place, index, component)[obs.pose])
    out = np.zeros(prediction.gradient.shape[:2])
    if place == "ball":
        moved = prediction.ball_rotation[prediction.pose][:, :, component]
        out[:, :3] = moved if prediction.direction is None else np.sum(moved * prediction.direction, axis=1, keepdims=True)
    elif place == "point":
        out[:, component : component + 1] = 1.0  # a distance has the first component alone
    elif place == "orientation":
        if prediction.rotation is not None:  # where none is measured there is nothing to turn
            out[:, 3:] = prediction.rotation[:, :, component]
    else:
        raise ValueError(f"no such place: {place}")
    return out


def unit_twist(obs: Observations, prediction: Prediction, place: str, index: int, component: int) -> np.ndarray:
    """(P, 6): spatial twist of the arm, in the base frame, by a unit of one component of a joint, a frame of the arm or a station."""
    if place == "joint":
        return obs.cell.robot.chain.joint_twists(prediction.frames)[:, index]
    if place == "frame":
        return se3.adjoint(prediction.frames[:, index])[:, :, component]
    if place == "station":
        return -se3.adjoint(prediction.T_base_station)[:, :, component]  # moving the artefact is moving the arm back
    raise ValueError(f"{place} does not move the arm as a whole")


def accumulate(obs: Observations, terms: Sequence[Term], coefficients: Sequence[np.ndarray]) -> Displacements:
    """What the terms together do to the cell; coefficients: one (k,) array per term."""
    n = obs.cell.robot.n
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
