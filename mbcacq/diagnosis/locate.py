"""The map: for every attachment and every covariate, how much of what is left a smooth or a periodic function explains.

Only what free geometry and station poses (and whatever was adopted) cannot absorb counts; p-values are corrected for the
number of cells of the map, and of a spectral scan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2

from mbcacq.diagnosis import covariates, ripple
from mbcacq.diagnosis.screen import Screen, solve_block
from mbcacq.physics.situation import Situation

FINE = 16


@dataclass(frozen=True)
class Spot:
    """One cell of the map. kind: smooth, fine, periodic, ripple or constant. log10_p corrected for the number of cells; order of a wave."""

    at: str
    depends_on: str
    kind: str
    gain: float
    k: int
    log10_p: float
    order: float | None = None


@dataclass(frozen=True)
class Attachment:
    """A place that may move: its components, and whether its functions vary within a pose."""

    at: str
    components: tuple[tuple[str, int, int], ...]


def attachments(s: Situation) -> list[Attachment]:
    n, cell = s.n, s.obs.cell
    out = [Attachment(f"A{i + 1}", (("joint", i, 0),)) for i in range(n)]
    wrench = range(6)
    out += [Attachment(f"link{i}", tuple(("frame", i, c) for c in wrench)) for i in range(1, n)]
    out.append(Attachment("base", tuple(("frame", 0, c) for c in wrench)))
    out.append(
        Attachment("mount", tuple(("frame", n, c) for c in (wrench if s.scanner_on_flange or s.obs.rotation is not None else range(3))))
    )
    if s.scanner_on_flange and np.ptp(s.obs.xyz, axis=0).max() > 0:
        out.append(Attachment("scanner", tuple(("point", 0, c) for c in range(3))))
    stations = np.unique(s.obs.station)
    if len(stations) > 1:
        out += [
            Attachment(f"station{cell.stations[k].id}", tuple(("station", int(k), c) for c in range(3)))
            for k in stations
            if np.sum(s.obs.station == k) > 6
        ]
    return out


def mismatch(screen: Screen, s: Situation, cells: bool = True) -> list[Spot]:
    """All cells of the map, most significant first."""
    poses = covariates.of_poses(s)
    spots: list[Spot] = []
    for place in attachments(s):
        if place.at.startswith("station"):
            spots += _station(screen, s, place)
            continue
        if place.at == "scanner":
            spots += _scanner(screen, s, place, poses)
            continue
        for covariate in poses:
            F = covariate.functions
            gain = float(screen.gains(place.components, lambda _, F=F: F[None], np.zeros(1))[0])
            spots.append(_spot(place.at, covariate.name, "smooth", gain, len(place.components) * F.shape[1]))
    spots += _fine(screen, s)
    spots += _spectral(screen, s)
    spots += _balls(screen, s)
    correction = np.log10(max(len(spots), 1))
    spots = [Spot(p.at, p.depends_on, p.kind, p.gain, p.k, min(p.log10_p + correction, 0.0), p.order) for p in spots]
    return sorted(spots, key=lambda p: p.log10_p)


def _spot(at: str, name: str, kind: str, gain: float, k: int, tries: float = 1.0, order: float | None = None) -> Spot:
    return Spot(at, name, kind, gain, k, log10_tail(gain, k) + np.log10(tries), order)


def log10_tail(gain: float, k: int) -> float:
    """log10 of the probability that chance alone gains as much."""
    tail = chi2.logsf(max(gain, 0.0), k)
    if not np.isfinite(tail):  # first term of the asymptotic series
        tail = (k / 2 - 1) * np.log(gain / 2) - gain / 2 - gammaln(k / 2)
    return float(tail / np.log(10))


def _fine(screen: Screen, s: Situation) -> list[Spot]:
    """A joint's own angle once more, with functions narrow enough for a bump."""
    out = []
    for i in range(s.n):
        if np.ptp(s.obs.q[:, i]) > 0.02:
            F = covariates.smooth(f"q{i + 1}", s.obs.q[:, i], FINE).functions
            gain = float(screen.gains((("joint", i, 0),), lambda _, F=F: F[None], np.zeros(1))[0])
            out.append(_spot(f"A{i + 1}", f"q{i + 1}", "fine", gain, FINE))
    return out


def _spectral(screen: Screen, s: Situation) -> list[Spot]:
    from mbcacq.physics import gear_transmission_error

    out = []
    for candidate in gear_transmission_error.candidates(s):
        curve = screen.scan(candidate)
        j = int(np.argmax(curve))
        out.append(
            _spot(
                candidate.where[0],
                candidate.depends_on,
                "periodic",
                float(curve[j]),
                2,
                2 * candidate.hyper.independent,
                float(candidate.hyper.values[j]),
            )
        )
    return out


def _scanner(screen: Screen, s: Situation, place: Attachment, poses: list[covariates.Covariate]) -> list[Spot]:
    out = []
    for covariate in covariates.smooth_of_centres(s):
        units = [screen.linear.unit(*key) for key in place.components]
        columns = np.stack([u * f[:, None] for u in units for f in covariate.functions.T], axis=2)
        best = _spot(place.at, covariate.name, "smooth", block_gain(screen, columns), columns.shape[2])
        wave = ripple.scan(screen, covariate.values) if covariate.name in ("x", "y") else None
        if wave is not None:  # the more significant of two shapes of one dependence
            periodic = _spot(place.at, covariate.name, "ripple", wave.gain, 2, 2 * wave.independent, wave.frequency)
            best = replace(min(best, periodic, key=lambda p: p.log10_p), log10_p=min(best.log10_p, periodic.log10_p) + np.log10(2))
        out.append(best)
    for covariate in poses:
        if covariate.name in ("time", "pose") or covariate.name.endswith("_C"):
            F = covariate.functions
            gain = float(screen.gains(place.components, lambda _, F=F: F[None], np.zeros(1))[0])
            out.append(_spot(place.at, covariate.name, "smooth", gain, 3 * F.shape[1]))
    return out


def _station(screen: Screen, s: Situation, place: Attachment) -> list[Spot]:
    here = s.obs.station == place.components[0][1]
    key = s.order.astype(float)
    x = np.where(here, (key - key[here].mean()) / max(key[here].std(), 1e-12), 0.0)
    F = np.stack([x, np.where(here, x * x, 0.0)], axis=1)
    gain = float(screen.gains(tuple(("station", 0, c) for c in range(3)), lambda _: F[None], np.zeros(1))[0])
    return [_spot(place.at, "time" if s.obs.time_s is not None else "pose", "smooth", gain, 6)]


def _balls(screen: Screen, s: Situation) -> list[Spot]:
    if not s.scanner_on_flange:
        return []
    out, owner = [], s.obs.cell.ball_artefact
    for k, ball in enumerate(s.obs.cell.ball_ids):
        seen = s.obs.ball == k
        if seen.sum() < 3 or np.sum(owner == owner[k]) < 3:
            continue
        columns = np.stack([screen.linear.unit("ball", 0, c) * seen[:, None] for c in range(3)], axis=2)
        out.append(_spot(f"ball{ball}", "ball", "constant", block_gain(screen, columns), 3))
    return out


def block_gain(screen: Screen, columns: np.ndarray) -> float:
    """Gain of columns (M, R, k)."""
    X = screen.whiten(columns)
    taken = screen.all_projected.T @ X
    return solve_block(X.T @ X - taken.T @ taken, X.T @ screen.r, np.sum(X * X, axis=0))[0]
