"""Proof on data that took no part: whole stations (for one station: blocks of poses) are left out of every choice and fit.

What happens to a single station alone no other station can know of: whether such a model is good is judged on the stations elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.diagnosis.compose import columns_of
from mbcacq.diagnosis.finding import Finding, find
from mbcacq.diagnosis.linear import Linear
from mbcacq.diagnosis.model import NOTHING, Model
from mbcacq.diagnosis.screen import Screen
from mbcacq.diagnosis.setup import Setup
from mbcacq.diagnosis.smooth import SmoothModel
from mbcacq.diagnosis.whitening import Noise
from mbcacq.physics import payload, steps

MOST = 0.8  # share of the centres that must be elsewhere for them to decide


@dataclass(frozen=True)
class Quality:
    """Sums over centres: squared 3D distances (mm^2), count, chi2 and its degrees of freedom."""

    square: float
    count: int
    chi2: float
    dof: float

    def __add__(self, other: Quality) -> Quality:
        return Quality(self.square + other.square, self.count + other.count, self.chi2 + other.chi2, self.dof + other.dof)

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.square / max(self.count, 1)))

    @property
    def chi2_dof(self) -> float:
        return float(self.chi2 / max(self.dof, 1e-9))


EMPTY = Quality(0.0, 0, 0.0, 0.0)


@dataclass(frozen=True)
class Proof:
    """before and after on left-out data, how they were left out. without: the same with one effect left out of the model, by its name;
    of what has no name by 'unknown:PLACE'. picks: names that each fold found. empty: names beside others that predict nothing better; they
    are not in ``after``. decides: before and after where the model may be judged, see above.
    named: of a long recording, whose groups could do what names do: with the names alone, to which each name is held.
    """

    before: Quality
    after: Quality
    split: str
    without: dict[str, Quality]
    picks: tuple[tuple[str, ...], ...]
    empty: tuple[str, ...] = ()
    decides: tuple[Quality, Quality] = (EMPTY, EMPTY)
    named: Quality | None = None

    def gain(self, key: str) -> float:
        """Share of the held-out excess over the noise floor that an effect removes."""
        excess = max(self.before.chi2 - self.before.dof, 1e-9)
        whole = self.named or self.after
        return float(np.clip((self.without.get(key, whole).chi2 - whole.chi2) / excess, 0, 1))

    @property
    def nameless(self) -> float:
        """The same of all that has no name."""
        excess = max(self.before.chi2 - self.before.dof, 1e-9)
        return float(np.clip(((self.named or self.before).chi2 - self.after.chi2) / excess, 0, 1))


def split(linear: Linear, folds: int) -> tuple[np.ndarray, str]:
    """(P,) fold of each pose. Stations go whole; a single station is cut into blocks of its order of measurement."""
    obs = linear.obs
    stations = np.unique(obs.station)
    if len(stations) >= 3:
        size = np.bincount(obs.station, minlength=len(obs.cell.stations))
        kind = np.array([[a.id for a in obs.cell.artefacts].index(s.artefact) for s in obs.cell.stations])
        ranked = sorted(stations, key=lambda k: (kind[k], -size[k], k))
        fold = np.zeros(len(obs.cell.stations), int)
        fold[ranked] = np.arange(len(ranked)) % min(folds, len(ranked))
        return fold[obs.station], "station"
    key = np.arange(obs.n_poses) if obs.time_s is None else np.argsort(np.argsort(obs.time_s, kind="stable"))
    blocks = key * (4 * folds) // obs.n_poses
    return blocks % folds, "block"


def prove(setup: Setup, full: Finding, folds: int = 4) -> Proof:
    """The whole search repeated without each fold, its model tried on the fold; weights are those of the full data."""
    linear = full.before.linear
    fold, how = split(linear, folds)
    elsewhere = away_from(full)
    everywhere = full.smooth is not None and not full.cells
    nameless = dict.fromkeys(g.at for g in full.smooth.groups) if full.cells else ()
    named = EMPTY
    keys = [*full.model.names, *(f"unknown:{at}" for at in nameless)]
    before, after, parts = EMPTY, EMPTY, []
    before_there, after_there = EMPTY, EMPTY
    without = dict.fromkeys(keys, EMPTY)
    for k in range(int(fold.max()) + 1):
        train = linear.keep & (fold != k)[linear.obs.pose]
        test = linear.keep & (fold == k)[linear.obs.pose]
        plain = judge(linear, train, test, NOTHING, None, full.noise)
        before += plain
        if not keys and not everywhere:  # nothing is claimed, there is nothing to prove
            after += plain
            continue
        part = find(replace(setup, linear=linear), train, expected=full.smooth is not None)
        whole = judge(linear, train, test, part.model, part.smooth, full.noise)
        after += whole
        there = test & elsewhere
        if there.any() and not elsewhere.all():
            before_there += judge(linear, train, there, NOTHING, None, full.noise)
            after_there += judge(linear, train, there, part.model, part.smooth, full.noise)
        groups = part.smooth
        if everywhere:
            part, groups = replace(part, smooth=None), part.smooth
            whole = judge(linear, train, test, part.model, None, full.noise)
            named += whole
        parts.append((train, test, part.model, groups))
        for key in keys:
            model, rest = less(part, key)
            same = model is part.model and rest is part.smooth
            without[key] += whole if same else judge(linear, train, test, model, rest, full.noise)
    empty = ()
    if len(full.model.names) > 1 and payload.NAME not in full.model.names:
        empty = tuple(n for n in full.model.names if not stays(full, n) and without[n].chi2 <= (named if everywhere else after).chi2)
    if empty:
        after = sum((judge(linear, *sets, model.without(empty), rest, full.noise) for *sets, model, rest in parts), EMPTY)
    decides = (before_there, after_there) if before_there.count > MOST * before.count else (before, after)
    return Proof(before, after, how, without, tuple(model.names for *_, model, _ in parts), empty, decides, named if everywhere else None)


def stays(full: Finding, name: str) -> bool:
    """Whether an effect happens to single stations alone."""
    return all(w.startswith("station") for c, _ in full.model.members if c.name == name for w in c.where)


def away_from(full: Finding) -> np.ndarray:
    """(M,) bool of the centres at stations to which nothing of the model happens alone."""
    obs = full.before.linear.obs
    alone = {w for c, _ in full.model.members if stays(full, c.name) for w in c.where}
    return ~np.isin(obs.station, [j for j, s in enumerate(obs.cell.stations) if f"station{s.id}" in alone])[obs.pose]


def less(part: Finding, key: str) -> tuple[Model, SmoothModel | None]:
    """A fold's model without one effect."""
    if key.startswith("unknown:"):
        at = key.removeprefix("unknown:")
        there = part.smooth is not None and any(g.at == at for g in part.smooth.groups)
        return part.model, part.smooth.without(at) if there else part.smooth
    return part.model.without((key,)), part.smooth


def judge(linear: Linear, train: np.ndarray, test: np.ndarray, model: Model, rest: SmoothModel | None, noise: Noise) -> Quality:
    """Fit geometry and the model's coefficients on train, look at test, where only stations unseen in training are free, and the moment of
    a change that fell among the poses left out.
    """
    fitted = linear.restricted(train)
    columns, sigma = columns_of(fitted, model, rest)
    solution = solve(fitted.whitener(noise), columns, sigma, linear.residual)
    left = linear.residual - columns @ solution
    best = on_new_stations(linear, train, test, left, noise)
    first = columns.shape[2] - sum(c.k for c, _ in model.members) - (0 if rest is None else rest.columns.shape[2])
    for (candidate, hyper), p in zip(model.members, model.parts(), strict=True):
        mine = slice(first + p.start, first + p.stop)
        for moment in steps.undecided(candidate, hyper, linear.obs, train):
            other = left + (columns[:, :, mine] - linear.columns(candidate.build(moment))) @ solution[mine]
            best = min(best, on_new_stations(linear, train, test, other, noise), key=lambda quality: quality.chi2)
    return best


def on_new_stations(linear: Linear, train: np.ndarray, test: np.ndarray, left: np.ndarray, noise: Noise) -> Quality:
    """Residual (M, R) on test after the poses of stations that training has not seen are fitted to it."""
    obs = linear.obs
    whiten = linear.restricted(test).whitener(noise)
    unseen = [k for k in np.unique(obs.station[obs.pose[test]]) if k not in set(obs.station[obs.pose[train]])]
    dof = float(test.sum() * linear.width)
    if unseen:
        columns, sigma, layout = linear.nuisance()
        position = {k: j for j, k in enumerate(np.unique(obs.station))}
        free = np.concatenate(
            [np.arange(layout.stations.start + 6 * position[k], layout.stations.start + 6 * position[k] + 6) for k in unseen]
        )
        station, width = columns[:, :, free], sigma[free]
        Z = whiten(station) * width
        normal = Z.T @ Z
        left = left - station @ (width * np.linalg.solve(normal + np.eye(len(free)), Z.T @ whiten(left)))
        dof -= float(np.trace(np.linalg.solve(normal + np.eye(len(free)), normal)))
    r = whiten(left)
    return Quality(float(np.sum(left[test, :3] ** 2)), int(test.sum()), float(r @ r), dof)


def solve(whiten, columns: np.ndarray, sigma: np.ndarray, residual: np.ndarray) -> np.ndarray:
    Z = whiten(columns) * sigma
    normal = Z.T @ Z
    normal[np.diag_indices_from(normal)] += 1.0
    return sigma * np.linalg.solve(normal, Z.T @ whiten(residual))


def on_train(screen: Screen, model: Model, rest: SmoothModel | None) -> tuple[Quality, np.ndarray]:
    """The same on the data fitted, and the residual (M, R)."""
    linear = screen.linear
    columns, sigma = columns_of(linear, model, rest)
    Z = screen.whiten(columns) * sigma
    normal = Z.T @ Z
    inverse = np.linalg.inv(normal + np.eye(len(sigma)))
    solution = sigma * (inverse @ (Z.T @ screen.r0))
    left = linear.residual - columns @ solution
    keep = linear.keep
    dof = keep.sum() * linear.width - float(np.sum(inverse * normal))
    r = screen.whiten(left)
    return Quality(float(np.sum(left[keep, :3] ** 2)), int(keep.sum()), float(r @ r), dof), left
