"""Clearance of the mount: a scanner that is loose falls from one seat to the other as the flange turns over.

Which poses are in which seat follows from the line along which gravity closes the clearance. A line that is ten degrees off puts some poses
into the wrong seat, so lines are looked for in what the geometry leaves, beside those that are always tried.
"""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, HyperEstimate, Hyperparameter, Missing, Parameters, StandstillRows, angles, vector
from mbcacq.effects.functions import DescribedPart, of
from mbcacq.quantities import from_degrees, in_degrees

NAME = "mount_clearance"
DECLARED = Declaration(challenge=Challenge(number=23))
GROSS = 8.0  # medians, beyond which a residual counts as no more
FEWEST = 4  # poses in the rarer seat
# (azimuth, elevation) in flange axes of the line along which gravity closes the clearance; the opposite direction is the same line.
LINES = [
    *((azimuth, 0) for azimuth in range(0, 180, 30)),
    *((azimuth, 30) for azimuth in range(0, 360, 30)),
    *((azimuth, 60) for azimuth in range(0, 360, 60)),
    (0, 90),
]
INDEPENDENT = 200  # lines that put the poses into seats differently
STARTS, STEPS = 3, (15, 8, 4, 2, 1)  # best of the lines from which nearer ones are looked for, and by how many degrees
# Component of gravity along the line where it changes seats: friction holds it.
FALLS = np.array([-0.25, -0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15, 0.25])
AT_ONCE = 1e-6  # of that component, over which a hyperbolic tangent is a sign


def candidates(context: Context) -> list[Candidate]:
    """For each of the lines a shift (mm) and, where the measurement shows it, a turn (rad), half of the way between both seats."""
    components = range(6) if context.scanner_on_flange or context.obs.rotation is not None else range(3)
    typical = np.array([0.03] * 3 + [1e-4] * 3)[: len(components)]
    out = []
    for azimuth, elevation in dict.fromkeys([*LINES, *lines_of_residual(context)]):
        cause = f"gravity_along_{context.tags[-1]}_{azimuth}_{elevation}"
        values = places_to_fall(context.value(cause))
        if len(values):
            out.append(_along(context, cause, components, values, typical))
    if not out:
        raise Missing("the flange is never turned over")
    return out


def places_to_fall(along: np.ndarray) -> np.ndarray:
    """Components of gravity along a line at which poses, by theirs (P,), may change seats."""
    return np.array([at for at in FALLS if min(np.sum(along > at), np.sum(along < at)) >= FEWEST])


def lines_of_residual(context: Context) -> list[tuple[int, int]]:
    """Lines by whose seats the mean residual of a pose varies most, beyond what varies with gravity evenly."""
    if not context.scanner_on_flange:
        return []
    obs, down = context.obs, context.flange_gravity
    count = np.maximum(np.bincount(obs.pose, minlength=obs.n_poses), 1)
    residual = obs.xyz - context.prediction.xyz
    middle = np.stack([np.bincount(obs.pose, residual[:, c], obs.n_poses) / count for c in range(3)], axis=1)
    middle = np.clip(middle, *(np.median(middle, axis=0) + GROSS * np.median(np.abs(middle), axis=0) * side for side in (-1, 1)))
    even, _ = np.linalg.qr(np.c_[np.ones(obs.n_poses), down])
    middle = middle - even @ (even.T @ middle)

    def gain(line: tuple[int, int]) -> float:
        seats = np.where((down @ _unit(*line))[:, None] > FALLS, 1.0, -1.0)
        rest = seats - even @ (even.T @ seats)
        return float(np.max(np.sum((rest.T @ middle) ** 2, axis=1) / np.maximum(np.sum(rest**2, axis=0), 1.0)))

    known = {line: gain(line) for line in LINES}
    out = []
    for start in sorted(LINES, key=lambda line: -known[line])[:STARTS]:
        best = start
        for step in STEPS:
            for line in _beside(best, step):
                known.setdefault(line, gain(line))
                best = max(best, line, key=lambda one: known[one])
        out.append(best)
    return out


def _beside(line: tuple[int, int], step: int) -> list[tuple[int, int]]:
    """Lines that lean by some degrees away from one, in whole degrees and on the upper half."""
    unit = _unit(*line)
    across = np.cross(unit, np.eye(3)[int(np.argmin(np.abs(unit)))])
    across /= np.linalg.norm(across)
    out, lean = [], from_degrees(step)
    for turn in from_degrees(np.arange(0, 360, 45)):
        to = np.cos(lean) * unit + np.sin(lean) * (np.cos(turn) * across + np.sin(turn) * np.cross(unit, across))
        to = to if to[2] >= 0 else -to
        out.append((int(in_degrees(np.arctan2(to[1], to[0])).round()) % 360, int(in_degrees(np.arcsin(min(to[2], 1.0))).round())))
    return out


def _unit(azimuth: int, elevation: int) -> np.ndarray:
    a, e = from_degrees([float(azimuth), float(elevation)])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _along(context: Context, cause: str, components: range, values: np.ndarray, typical: np.ndarray) -> Candidate:
    def described(at: float) -> list[DescribedPart]:
        seat = of(cause, "sigmoid", at, AT_ONCE)
        return [DescribedPart("frame", context.n, c, ((),) * c + (seat,) + ((),) * (len(components) - 1 - c)) for c in components]

    def report(c: np.ndarray, v: np.ndarray, at: HyperEstimate) -> Parameters:
        out = {"shift_mm": vector(2 * c[:3], 4 * v[:3, :3])}
        return out | {"turn_deg": angles(2 * c[3:], 4 * v[3:, 3:])} if len(c) == 6 else out

    hyper, rarity = Hyperparameter("falls_at", values, 2.0, refine=False), 1.0 / INDEPENDENT
    return Candidate(NAME, ("mount",), cause, StandstillRows(described, typical), report, hyper, variant=cause, rarity=rarity)
