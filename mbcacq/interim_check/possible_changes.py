"""What may have changed in a cell, as columns of the rows of a check: mastering, mount, links, artefact, every effect of the catalogue."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.design.effect_detectability import hyper_values
from mbcacq.effects.catalogue import candidates
from mbcacq.effects.context import Context
from mbcacq.effects.described import parts_of
from mbcacq.effects.effect import FADING, MOMENT
from mbcacq.estimation import terms
from mbcacq.estimation.forward_model import CellState, Prediction
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.interim_check.options import OPTIONS
from mbcacq.model.observations import Observations

UNNAMED, SCANNER = "unnamed", "the scanner"
TWIST = ("x", "y", "z", "rx", "ry", "rz")
LEAST = 1e-9  # of a column against the noise: below, the rows do not show it at all


@dataclass(frozen=True)
class PossibleChange:
    """Something that may have changed.

    Attributes
    ----------
    name : str
        'mastering', 'mount', 'artefact', 'link', 'tool', 'unnamed', or that of an effect.
    where : str
        Its location.
    parameters, units : tuple[str, ...]
        Parameters and units of its k coefficients.
    usual : ndarray
        (k,) their usual change.
    columns : ndarray
        (R, k) what that does to the rows.
    weight : float
        Prior probability beside the others.
    """

    name: str
    where: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    usual: np.ndarray
    columns: np.ndarray
    weight: float = 1.0

    def select(self, keep: np.ndarray) -> PossibleChange:
        """At the rows where ``keep`` (R,) bool holds."""
        return replace(self, columns=self.columns[keep])


def possible_changes(obs: Observations, state: CellState, prediction: Prediction, standing: bool) -> list[PossibleChange]:
    """All that may change, at the poses and centres of a planned check. standing: artefacts stay where they stand between checks.

    Prior probabilities are equal between names, and among the locations and variants of each.
    """
    found = [*_masterings(obs, state, prediction), _mount(obs, prediction), *_links(obs, state, prediction)]
    if standing:
        found += _artefacts(obs, prediction)
    found += _catalogued(obs, state, prediction)
    found += [_unnamed(obs, state, prediction), _unnamed_centres(obs)]
    visible = [r for r in found if np.abs(r.columns).max(initial=0.0) > LEAST]
    count: dict[str, int] = {}
    for change in visible:
        count[change.name] = count.get(change.name, 0) + 1
    return [replace(r, weight=1 / len(count) / count[r.name]) for r in visible]


def rows_of(each: np.ndarray) -> np.ndarray:
    """Columns (M, R, k) of centres as columns of rows (M R, k)."""
    return each.reshape(-1, each.shape[-1])


def joint_columns(state: CellState, prediction: Prediction) -> np.ndarray:
    """(M, R, n): by the zero of each joint."""
    return prediction.by_twists(state.chain.joint_twists(prediction.frames))


def _masterings(obs: Observations, state: CellState, prediction: Prediction) -> list[PossibleChange]:
    J = joint_columns(state, prediction)
    usual = np.array([OPTIONS.mastering])
    axes = [(obs.cell.robot.axes[j], rows_of(J[:, :, j : j + 1] * usual)) for j in range(state.chain.n)]
    return [PossibleChange("mastering", axis, (f"{axis} zero",), ("rad",), usual, columns) for axis, columns in axes]


def twist_columns(obs: Observations, prediction: Prediction, place: str, index: int) -> np.ndarray:
    """(M, R, 6): by the local twist of a frame of the arm, or of an artefact's placement."""
    return np.stack([terms.unit(obs, prediction, place, index, c) for c in range(6)], axis=2)


def station_columns(obs: Observations, prediction: Prediction) -> dict[int, np.ndarray]:
    """Index of each station that has poses -> (M, R, 6): by the local twist of its artefact."""
    columns = twist_columns(obs, prediction, "station", 0)
    return {int(s): columns * (obs.station[obs.pose] == s)[:, None, None] for s in np.unique(obs.station)}


def _moved(name: str, where: str, columns: np.ndarray, mm: float, rad: float) -> PossibleChange:
    """A change of a frame's place, by its columns (M, R, 6); mm, rad: usual sizes."""
    usual = np.repeat([mm, rad], 3)
    units = ("mm",) * 3 + ("rad",) * 3
    return PossibleChange(name, where, TWIST, units, usual, rows_of(columns * usual))


def _mount(obs: Observations, prediction: Prediction) -> PossibleChange:
    columns = twist_columns(obs, prediction, "frame", obs.cell.robot.n)
    return _moved("mount", "scanner on the flange", columns, OPTIONS.mount_mm, OPTIONS.mount_rad)


def _artefacts(obs: Observations, prediction: Prediction) -> list[PossibleChange]:
    return [
        _moved("artefact", f"station {obs.cell.stations[s].id}", columns, OPTIONS.station_mm, OPTIONS.station_rad)
        for s, columns in station_columns(obs, prediction).items()
    ]


def _links(obs: Observations, state: CellState, prediction: Prediction) -> list[PossibleChange]:
    """Each link by itself: its length, offset and twist."""
    twists = state.chain.parameter_twists(prediction.frames, obs.q)
    chosen, units = ("d", "a", "alpha"), ("mm", "mm", "rad")
    at = [PARAMETERS.index(p) for p in chosen]
    usual = np.array([OPTIONS.link_mm, OPTIONS.link_mm, OPTIONS.link_rad])
    each = [rows_of(prediction.by_twists(twists[:, i, at]) * usual) for i in range(state.chain.n)]
    return [PossibleChange("link", f"link {tag}", chosen, units, usual, own) for tag, own in zip(obs.cell.robot.tags, each, strict=True)]


def _catalogued(obs: Observations, state: CellState, prediction: Prediction) -> list[PossibleChange]:
    """Every effect of the catalogue at its usual size, by itself and, where it acts at one place of several, at all of them at once."""
    context = Context(obs, state, prediction)
    found, _ = candidates(context)
    out: list[PossibleChange] = []
    together: dict[tuple[str, str, int], list[PossibleChange]] = {}
    for candidate in found:
        if candidate.hyper is not None and candidate.hyper.kind in (MOMENT, FADING):
            continue  # what happens within one check says nothing about days
        for number, hyper in enumerate(hyper_values(candidate, OPTIONS.hypers)):
            one = terms.term(candidate.name, parts_of(candidate, context, hyper))
            columns = rows_of(terms.columns(obs, prediction, one)) * candidate.typical
            what = "" if hyper is None else f", {candidate.hyper.name if candidate.hyper else ''} {hyper:.4g}"
            names, where = tuple(f"{candidate.name}[{k}]" for k in range(candidate.k)), "+".join(candidate.where) + what
            change = PossibleChange(candidate.name, where, names, ("",) * candidate.k, candidate.typical, columns)
            out.append(change)
            if len(candidate.where) == 1:
                together.setdefault((candidate.name, candidate.variant, number), []).append(change)
    return [*out, *(_together(several) for several in together.values() if len(several) > 1), *_tool(context, prediction)]


def _together(several: list[PossibleChange]) -> PossibleChange:
    """One effect at all of its places, each with coefficients of its own: gears wear together."""
    columns, usual = np.concatenate([r.columns for r in several], axis=1), np.concatenate([r.usual for r in several])
    parameters = tuple(f"{name} at {r.where}" for r in several for name in r.parameters)
    _, comma, hyper = several[0].where.partition(",")
    return PossibleChange(several[0].name, f"several places{comma}{hyper}", parameters, ("",) * len(usual), usual, columns)


def _tool(context: Context, prediction: Prediction) -> list[PossibleChange]:
    """A tool of another weight, through the elasticity of the joints: each bends by its own share."""
    if not context.masses_known:
        return []
    J = joint_columns(context.state, prediction)
    bent = np.stack([context.value(f"payload_torque_{tag}_mass") for tag in context.tags], axis=1)
    usual = OPTIONS.tool_kg * OPTIONS.elastic
    columns = rows_of(J * (bent * usual)[context.obs.pose][:, None, :])
    shown = np.abs(columns).max(axis=0) > LEAST
    parameters = tuple(context.axes[i] for i in np.flatnonzero(shown))
    count = len(parameters)
    return [PossibleChange("tool", "its weight", parameters, ("",) * count, np.full(count, usual), columns[:, shown])]


def _unnamed(obs: Observations, state: CellState, prediction: Prediction) -> PossibleChange:
    """Every joint at every pose by itself: what no name on the list describes, and still stays from day to day."""
    J = joint_columns(state, prediction) * OPTIONS.unnamed
    n = J.shape[2]
    k = obs.n_poses * n
    columns = np.zeros((J.shape[0], J.shape[1], k))
    for p in range(obs.n_poses):
        here = obs.pose == p
        columns[here, :, p * n : (p + 1) * n] = J[here]
    return PossibleChange(UNNAMED, "the arm", ("",) * k, ("rad",) * k, np.full(k, OPTIONS.unnamed), rows_of(columns))


def _unnamed_centres(obs: Observations) -> PossibleChange:
    """Every measured centre by itself: what moves the balls of one pose against each other, and is no effect of the catalogue.

    Without it the null would take such a change for a larger noise, which it repeats from day to day and so is not.
    """
    k, usual = 3 * obs.n_centres, OPTIONS.unnamed_mm
    return PossibleChange(UNNAMED, SCANNER, ("",) * k, ("mm",) * k, np.full(k, usual), usual * np.eye(k))


def jitter(obs: Observations, state: CellState, prediction: Prediction, point: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """(R, R) covariance of the rows by the noise of a centre (3,) mm and of the joints (n,) rad, which moves all of a pose together."""
    J = prediction.by_twists(state.chain.joint_twists(prediction.frames)) * joint
    flat = J.reshape(-1, J.shape[2])
    pose = np.repeat(obs.pose, J.shape[1])
    return (flat @ flat.T) * (pose[:, None] == pose) + np.diag(np.tile(np.asarray(point, dtype=float) ** 2, len(obs.pose)))
