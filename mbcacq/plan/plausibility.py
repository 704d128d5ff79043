"""Values that can be read but cannot be meant: lengths in metres, angles in radians, balls that overlap or cannot be scanned."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from mbcacq.model.cell_schema import ArtefactSpec
from mbcacq.plan.planned import LoadedPlan
from mbcacq.plan.yaml_source import Path_

SMALLEST_BALL_MM, LARGEST_BALL_MM = 1.0, 500.0  # smaller ones show no scanner enough of themselves, larger ones no arm carries past
SMALLEST_ARTEFACT_MM = 2.0  # an artefact of 2 m in metres is 2
SMALLEST_DISTANCE_MM = 5.0  # from the base to an artefact; a place 5 m away in metres is 5
SMALLEST_MOUNT_MM = 1.0  # from the flange to the scanner's frame; a scanner 1 m away in metres is 1
LEAST_LIMIT = np.radians(30.0)  # an axis that moves less may well be meant to stand within 2 pi deg
BALLS_FOR_ORIENTATION = 3  # not on one line: fewer leave a rotation of the artefact open

Implausible = tuple[Path_, str]


def implausible_artefact(spec: ArtefactSpec) -> Implausible | None:
    """Where in the artefact file something cannot be meant, and the sentence about it. A diameter of 0 says that it is not known."""
    for index, ball in enumerate(spec.balls):
        if ball.diameter_mm and not SMALLEST_BALL_MM <= ball.diameter_mm <= LARGEST_BALL_MM:
            guess = f" ({ball.diameter_mm:g} m are {1000 * ball.diameter_mm:g} mm)" if ball.diameter_mm < SMALLEST_BALL_MM else ""
            sentence = (
                f"ball {ball.id} has a diameter of {ball.diameter_mm:g} mm, outside {SMALLEST_BALL_MM:g} to {LARGEST_BALL_MM:g} mm; "
                f"give it in mm{guess}"
            )
            return ("balls", index, "diameter_mm"), sentence
    centres = np.array([b.centre_mm for b in spec.balls], dtype=float)
    size = max((float(np.linalg.norm(a - b)) for a, b in combinations(centres, 2)), default=np.inf)
    if size < SMALLEST_ARTEFACT_MM:
        return ("balls",), f"all balls of artefact '{spec.id}' lie within {size:.3g} mm, which looks like metres; give centre_mm in mm"
    for i, j in combinations(range(len(centres)), 2):
        first, second, apart = spec.balls[i], spec.balls[j], float(np.linalg.norm(centres[i] - centres[j]))
        touching = (first.diameter_mm + second.diameter_mm) / 2
        if apart < touching:
            sentence = (
                f"balls {first.id} and {second.id} overlap: their centres are {apart:.3g} mm apart, their radii are {touching:.3g} mm "
                "together; correct centre_mm or diameter_mm (mm)"
            )
            return ("balls", j), sentence
    return None


def looks_like_metres(translation_mm: Sequence[float], smallest_mm: float) -> str:
    """A sentence about a length in mm that is too short to be one, or ''. Zero is a length that is left open."""
    length = float(np.linalg.norm(translation_mm))
    if length == 0 or length >= smallest_mm:
        return ""
    return f"a translation of {length:.3g} mm looks like metres; give translation_mm in mm"


def looks_like_radians(angles_deg: Sequence[float], limits: np.ndarray) -> str:
    """A sentence about joint angles in deg that are radians, or ''.

    limits: (n, 2) rad. Radians are all within 2 pi and have decimals; a posture of single small angles in degrees has none, or the axes
    move little.
    """
    angles = np.array(angles_deg, dtype=float)
    small = np.abs(angles).max(initial=0.0) <= 2 * np.pi and bool(np.all(np.abs(limits).max(axis=1) > LEAST_LIMIT))
    uneven = np.abs(2 * angles - np.round(2 * angles)) > 1e-6  # no multiple of half a degree
    if not small or np.count_nonzero(uneven) < 2:
        return ""
    meant = ", ".join(f"{a:.0f}" for a in np.degrees(angles))
    return f"all joint angles are within 2 pi, which looks like radians; give them in degrees ([{meant}])"


def lacks_orientation(loaded: LoadedPlan) -> Implausible | None:
    """Where a plan calibrates with artefacts of fewer than three balls only, or of balls on one line: the sentence about it."""
    artefact_of = {s.id: loaded.cell.artefact(s.artefact) for s in loaded.cell.stations}
    first: Implausible | None = None
    for index, step in enumerate(loaded.plan.steps):
        if step.phase == "verification":
            continue
        for station in map(str, getattr(step, "stations", None) or (getattr(step, "station", ""),)):
            artefact = artefact_of[station]
            spread = np.linalg.svd(artefact.centres - artefact.centres.mean(axis=0), compute_uv=False)
            if len(artefact.ball_ids) >= BALLS_FOR_ORIENTATION and spread[1] > 1e-3 * spread[0]:
                return None
            what = (
                "has its balls on one line" if len(artefact.ball_ids) >= BALLS_FOR_ORIENTATION else f"has {_balls(len(artefact.ball_ids))}"
            )
            sentence = (
                f"step '{step.name}' calibrates with artefact '{artefact.id}', which {what} and leaves its orientation open; "
                "calibrate with three balls or more that are not on one line, and keep this artefact for the phase "
                "'verification'"
            )
            first = first or (("steps", index), sentence)
    return first


def _balls(count: int) -> str:
    return "one ball" if count == 1 else f"{count} balls"
