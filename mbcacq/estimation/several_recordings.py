"""Several recordings of one arm as one problem: arm and effects are shared; base, tool, stations, artefacts and noise are not.

Values of one quantity from several recordings are a random effect: a common value and a variance between the recordings, by restricted
maximum likelihood (Hardy, Thompson 1996).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from scipy.special import chdtrc

from mbcacq.errors import ConfigError
from mbcacq.estimation.adjustment import Adjustment, adjust_recording
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import CalibrationOptions, select_phases
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Artefact, Cell, Station
from mbcacq.model.json_text import Number
from mbcacq.model.observations import Observations

OPTIONAL = ("phase", "time_s", "direction", "movement", "torque", "current", "velocity", "n_points", "rms_mm", "rotation")
BALL_STEP = 1000  # certificate numbers of the second recording begin here, those of the third at twice this


OF_ONE = re.compile(r"hand_eye\[\d+\]|@\d+")  # in names that stand in the common problem only


def joint_problem(
    recordings: Sequence[Observations], options: CalibrationOptions
) -> tuple[Observations, CellState, tuple[Adjustment, ...]]:
    """All recordings as one set of observations, the state from which they are adjusted together, and every recording adjusted alone, for
    its tool, stations, outliers and noise.

    Raises ConfigError where they are not of one arm, CalibrationError where one contradicts its cell.
    """
    if any(one.shared is not None or one.cell.length_scale for one in recordings):
        raise ConfigError("recordings of images or of distances have errors of their own instrument; calibrate them one by one")
    hold = tuple(name for name in options.hold if not OF_ONE.search(name))
    alone = replace(options, refuse=False, terms=(), hold=hold)
    parts = tuple(adjust_recording(select_phases(one, options), alone) for one in recordings)
    return combined([part.lineariser.obs for part in parts], parts), combined_state(parts), parts


def combined(recordings: Sequence[Observations], parts: Sequence[Adjustment]) -> Observations:
    """The recordings as one set of observations. Raises ConfigError where they are not of one arm and one kind of measurement."""
    _refuse_different_arms(recordings)
    first = recordings[0]
    poses, stations = _offsets([r.n_poses for r in recordings]), _offsets([len(r.cell.stations) for r in recordings])
    balls = _offsets([len(r.cell.ball_ids) for r in recordings])

    def column(name: str) -> np.ndarray | None:
        each = [getattr(r, name) for r in recordings]
        return None if any(one is None for one in each) else np.concatenate(each)

    columns: dict[str, Any] = {name: column(name) for name in OPTIONAL}
    common = [name for name in first.temperatures if all(name in r.temperatures for r in recordings)]
    return Observations(
        cell=_cell(recordings),
        pose_id=np.arange(poses[-1]),
        station=np.concatenate([r.station + s for r, s in zip(recordings, stations, strict=False)]),
        q=np.concatenate([r.q for r in recordings]),
        pose=np.concatenate([r.pose + p for r, p in zip(recordings, poses, strict=False)]),
        ball=np.concatenate([r.ball + b for r, b in zip(recordings, balls, strict=False)]),
        xyz=np.concatenate([r.xyz for r in recordings]),
        payload_kg=np.concatenate(
            [np.broadcast_to(r.cell.robot.payload_mass if r.payload_kg is None else r.payload_kg, r.n_poses) for r in recordings]
        ),
        payload_com=np.concatenate([np.tile(r.cell.robot.payload_com, (r.n_poses, 1)) for r in recordings]),
        temperatures={name: np.concatenate([r.temperatures[name] for r in recordings]) for name in common},
        recording=np.concatenate([np.full(r.n_poses, i) for i, r in enumerate(recordings)]),
        noise_scale=np.concatenate([_noise_scale(part, parts[0], r) for part, r in zip(parts, recordings, strict=True)]),
        **columns,
    )


def combined_state(parts: Sequence[Adjustment]) -> CellState:
    """The state from which all are adjusted together: the mean arm, every tool and station as fitted alone."""
    states = [part.state for part in parts]
    first = states[0].chain
    mean = np.mean([s.chain.rows - first.rows for s in states], axis=0)
    chain: Chain = first.with_errors(mean)
    places, balls = (np.concatenate([getattr(s, name) for s in states]) for name in ("T_base_station", "balls"))
    return CellState(chain, np.stack([s.T_flange_scanner for s in states]), places, balls)


def _cell(recordings: Sequence[Observations]) -> Cell:
    """One cell with the artefacts and stations of all; names of the second recording end with '@2'."""
    artefacts: list[Artefact] = []
    stations: list[Station] = []
    for number, one in enumerate(recordings):
        suffix = "" if number == 0 else f"@{number + 1}"
        for a in one.cell.artefacts:
            ids = tuple(b + BALL_STEP * number for b in a.ball_ids)
            artefacts.append(replace(a, id=a.id + suffix, ball_ids=ids))
        stations += [replace(s, id=s.id + suffix, artefact=s.artefact + suffix) for s in one.cell.stations]
    first = recordings[0].cell
    return replace(first, artefacts=tuple(artefacts), stations=tuple(stations), simulated=all(r.cell.simulated for r in recordings))


def _noise_scale(part: Adjustment, first: Adjustment, obs: Observations) -> np.ndarray:
    """(P, 3 + n): noise of a recording over that of the first."""
    own, reference = (np.concatenate([p.noise.point, p.noise.joint]) for p in (part, first))
    return np.tile(own / reference, (obs.n_poses, 1))


def _refuse_different_arms(recordings: Sequence[Observations]) -> None:
    first = recordings[0].cell
    for number, one in enumerate(recordings[1:], 2):
        arm = one.cell.robot
        if not arm.chain.same_links(first.robot.chain):
            raise ConfigError(f"recording 1 is of '{first.robot.name}', recording {number} of '{arm.name}': other links; give one arm's")
        if one.cell.measurement != first.measurement or (one.rotation is None) != (recordings[0].rotation is None):
            raise ConfigError(f"recording {number} was measured in another way than recording 1; give recordings of one kind together")


def _offsets(counts: Sequence[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)])


DIFFERENT = 0.01  # p-value below which recordings are said to differ
GRID = np.r_[0.0, np.geomspace(1e-2, 1e2, 81)]  # standard deviation between recordings, in the mean standard deviation of one value


@dataclass(frozen=True, kw_only=True)
class BetweenRecordings:
    """One parameter, or coefficient, of an effect over several recordings of one arm.

    name, where: of the effect. values, stds: of each recording by itself, with the geometry of all. common +- common_std: what they share,
    its uncertainty with the variance between recordings; between_std: standard deviation from day to day beyond each value's own, 0 where
    the values agree; p_value: of values that differ as much although nothing changed.
    """

    name: str
    where: tuple[str, ...]
    parameter: str
    values: tuple[Number, ...]
    stds: tuple[Number, ...]
    common: Number
    common_std: Number
    between_std: Number
    p_value: Number

    @classmethod
    def of(cls, name: str, where: tuple[str, ...], parameter: str, values: np.ndarray, std: np.ndarray, **further: Any) -> Self:
        """The random effect behind values (R,) with standard deviations (R,). further: fields that a subclass adds."""
        between = between_std(values, std)
        common, own = weighted_mean(values, std**2 + between**2)
        fixed, _ = weighted_mean(values, std**2)
        return cls(
            name=name,
            where=where,
            parameter=parameter,
            values=tuple(values.tolist()),
            stds=tuple(std.tolist()),
            common=common,
            common_std=own,
            between_std=between,
            p_value=float(chdtrc(len(values) - 1, np.sum((values - fixed) ** 2 / std**2))),
            **further,
        )

    @property
    def differs(self) -> bool:
        """Whether the values are more unlike than their standard deviations allow."""
        return self.p_value <= DIFFERENT


def weighted_mean(values: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    """The mean of values (R,) by their inverse variance (R,), and its standard deviation."""
    weight = 1.0 / variance
    return float(np.sum(weight * values) / weight.sum()), float(1.0 / np.sqrt(weight.sum()))


def between_std(values: np.ndarray, std: np.ndarray) -> float:
    """Most probable standard deviation between recordings."""
    scale = float(np.sqrt(np.mean(std**2)))
    grid = GRID * max(scale, float(np.std(values)) / 10)
    variance = std**2 + grid[:, None] ** 2
    weight = 1.0 / variance
    total = weight.sum(axis=1)
    mean = np.sum(weight * values, axis=1) / total
    log = -0.5 * (np.log(variance).sum(axis=1) + np.log(total) + np.sum(weight * (values - mean[:, None]) ** 2, axis=1))
    return float(grid[int(np.argmax(log))])
