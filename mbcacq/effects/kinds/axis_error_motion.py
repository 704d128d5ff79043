"""The error motions of a slide or a table (ISO 230-1, ISO 230-7): what it carries is displaced or turned by its position.

A slide is not straight, and yaws, pitches and rolls, smoothly along its travel. The bearing of a table runs out and wobbles, a few times a
turn. The part that is constant, or proportional to the position of a slide, is the place and the direction of the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Declaration
from mbcacq.effects.effect import Candidate, HyperEstimate, Hyperparameter, ParameterEstimate, StandstillRows, Support, number
from mbcacq.effects.functions import ZERO, Column, DescribedPart, cosine, evaluate, of, scaled, sine

NAME = "axis_error_motion"
DECLARED = Declaration(of_slides=True)
HALF_WAVES = 6  # over the travel of a slide, whose rails are a few metres long
ORDERS = (1, 2, 3, 4)  # periods a turn of a table's bearing, in the axes of what it carries
LEAST_TRAVEL_MM, LEAST_TRAVEL_RAD = 50.0, 0.3  # over less of which nothing can be told from a place
# Typical sizes, and the largest: rails are laid to some 0.1 mm and 0.1 mrad a metre.
SIZE = {"mm": 0.05, "rad": 1e-4}
LARGEST = {"mm": 5.0, "rad": 5e-3}
LIMIT = "an axis that errs by so much is broken"
PIVOTS = np.linspace(-1000.0, 1000.0, 41)  # mm of a rotation, from the origin of the frame behind the joint, which is a convention


def candidates(context: Context) -> list[Candidate]:
    """Straightness, yaw, pitch and roll of each slide, wobble and run-out of each external axis that turns; coefficients in mm, rad."""
    robot = context.obs.cell.robot
    out = list[Candidate]()
    for i in range(context.n):
        slides, travel = i in robot.chain.sliding, float(np.ptp(context.obs.q[:, i]))
        if slides and travel > LEAST_TRAVEL_MM:
            out += [_candidate(context, i, *motion) for motion in _of_slide(context, i)]
        elif not slides and i < robot.external and travel > LEAST_TRAVEL_RAD:
            out += [_candidate(context, i, *motion) for motion in _of_table(context, i)]
    return out


# Name, unit, unit vectors (3,) along or about which it is, in the frame behind the joint, and the one along which its pivot may be: where a
# rotation has its pivot is no part of the description; and how often a turn of a table it is.
Motion = tuple[str, str, Sequence[np.ndarray], np.ndarray, int]


def _of_slide(context: Context, i: int) -> list[Motion]:
    along = _axes(context, i)[2]
    down = context.gravity_direction(i + 1).mean(axis=0)
    steep = abs(along @ down) > np.sqrt(0.5)
    upright = _axes(context, i)[1] if steep else -down
    vertical = upright - (upright @ along) * along
    vertical /= np.linalg.norm(vertical)
    across = np.cross(vertical, along)
    first, second = ("first", "second") if steep else ("horizontal", "vertical")
    turns = ("first_tilt", "second_tilt") if steep else ("yaw", "pitch")
    return [
        (f"{first}_straightness", "mm", [across], along, 0),
        (f"{second}_straightness", "mm", [vertical], along, 0),
        (turns[0], "rad", [vertical], along, 0),
        (turns[1], "rad", [across], vertical, 0),
        ("roll", "rad", [along], vertical, 0),
    ]


def _of_table(context: Context, i: int) -> list[Motion]:
    x, y, along = _axes(context, i)
    motions = (("wobble", "rad", [x, y], along), ("radial_run_out", "mm", [x, y], along), ("axial_run_out", "mm", [along], along))
    return [(f"{name}_{k}", unit, ways, arm, k) for k in ORDERS for name, unit, ways, arm in motions]


def _axes(context: Context, i: int) -> np.ndarray:
    """(3, 3) rows: the axes of the frame before joint i at zero, in the one behind it."""
    return context.obs.cell.robot.chain.link_transforms(np.zeros((1, context.n)))[0, i, :3, :3]


def _candidate(context: Context, i: int, motion: str, unit: str, ways: Sequence[np.ndarray], arm: np.ndarray, often: int) -> Candidate:
    cause, axis = context.position(i), context.axes[i]
    functions, order = _functions(context, i, often)

    def described(pivot: Any = 0.0) -> list[DescribedPart]:
        moved = [np.stack([(unit == "mm") * d, (unit == "rad") * d]) for d in ways]  # rows: shift, turn
        shifts = [np.cross(arm, d) if unit == "rad" else None for d in ways]
        parts = []
        for first, row in ((0, 0), (3, 1)):
            for c in range(3):
                columns = list[Column]()
                for m, shift in zip(moved, shifts, strict=True):
                    factor = m[row, c] if shift is None or row else pivot * shift[c]
                    columns += [scaled(f, factor) if np.any(factor) else ZERO for f in functions]
                if any(columns):
                    parts.append(DescribedPart("frame", i + 1, first + c, tuple(columns)))
        return parts

    values = evaluate(functions, context.value, context.obs.n_poses)
    q = context.obs.q[:, i]
    geometry = np.stack([np.ones_like(q), q] if i in context.obs.cell.robot.chain.sliding and unit == "mm" else [np.ones_like(q)], axis=1)
    values = values - geometry @ np.linalg.lstsq(geometry, values, rcond=None)[0]
    square = np.kron(np.eye(len(ways)), values.T @ values / len(q))

    def report(c: np.ndarray, v: np.ndarray, _: HyperEstimate) -> dict[str, ParameterEstimate]:
        """Root mean square over the poses of what is not geometry."""
        rms = float(np.sqrt(c @ square @ c))
        slope = square @ c / max(rms, 1e-30)
        return {f"{axis}.{motion}_rms_{unit}": number(rms, float(np.sqrt(slope @ v @ slope)))}

    rows = StandstillRows(described() if unit == "mm" else described, np.tile(SIZE[unit] / order, len(ways)))
    support, hyper = Support(LARGEST[unit], LIMIT), None if unit == "mm" else Hyperparameter("", PIVOTS, 3.0, refine=False)
    return Candidate(NAME, (axis,), cause, rows, report, hyper, several=True, variant=motion, support=support)


def _functions(context: Context, i: int, often: int) -> tuple[list[Column], np.ndarray]:
    """(k) functions of the position of joint i, and (k,) by which their sizes fall."""
    cause = context.position(i)
    if often:
        return [sine(cause, often), cosine(cause, often)], np.ones(2)
    low, high, order = float(context.obs.q[:, i].min()), float(context.obs.q[:, i].max()), np.arange(1.0, HALF_WAVES + 1)
    return [of(cause, "cosine", low, high, k) for k in order], order
