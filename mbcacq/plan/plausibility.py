"""Values that can be read but cannot be meant: lengths in metres, angles in radians, balls that overlap or cannot be scanned."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from mbcacq.model.cell import Artefact
from mbcacq.model.cell_schema import ArtefactSpec
from mbcacq.model.yaml_source import Path_
from mbcacq.plan.planned import LoadedPlan
from mbcacq.quantities import DEGREE, in_degrees

SMALLEST_BALL_MM, LARGEST_BALL_MM = 1.0, 500.0  # smaller ones show no scanner enough of themselves, larger ones no arm carries past
SMALLEST_ARTEFACT_MM = 2.0  # an artefact of 2 m in metres is 2
SMALLEST_DISTANCE_MM = 5.0  # from the base to an artefact; a place 5 m away in metres is 5
SMALLEST_MOUNT_MM = 1.0  # from the flange to the scanner's frame; a scanner 1 m away in metres is 1
LEAST_LIMIT = 30.0 * DEGREE  # an axis that moves less may well be meant to stand within 2 pi deg
LEAST_DIFFERENCE_MM = 0.3  # of two distances that a scan tells apart
BALLS_FOR_ORIENTATION = 3  # not on one line: fewer leave a rotation of the artefact open

Implausible = tuple[Path_, str]


def implausible_artefact(spec: ArtefactSpec) -> Implausible | None:
    """Where in the artefact file something cannot be meant, and the sentence about it. A diameter of 0 says that it is not known."""
    if not spec.certified:
        return ("certified",), f"artefact '{spec.id}' is not certified, and a plan needs to know where its balls are; measure them first"
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
    meant = ", ".join(f"{a:.0f}" for a in in_degrees(angles))
    return f"all joint angles are within 2 pi, which looks like radians; give them in degrees ([{meant}])"


def lacks_orientation(loaded: LoadedPlan) -> Implausible | None:
    """The sentence about a plan that calibrates only with artefacts of fewer than three balls, or of balls on one line."""
    artefact_of = {s.id: loaded.cell.artefact(s.artefact) for s in loaded.cell.stations}
    first: Implausible | None = None
    for index, step in enumerate(loaded.plan.steps):
        if step.phase in ("verification", "part"):
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


def symmetric(artefact: Artefact) -> str:
    """A sentence about an artefact that a rotation takes onto itself, so that its balls can be named in several ways, or ''."""
    order = _symmetry(artefact.centres, artefact.diameters)
    if order is None:
        return ""
    ball, other = next((artefact.ball_ids[k], artefact.ball_ids[image]) for k, image in enumerate(order) if image != k)
    return (
        f"artefact '{artefact.id}' looks the same turned (ball {ball} could be ball {other}), and only its planned place tells them apart: "
        f"make all distances between its balls differ by {LEAST_DIFFERENCE_MM:g} mm, or set it up close to where it is planned"
    )


def _symmetry(centres: np.ndarray, diameters: np.ndarray) -> tuple[int, ...] | None:
    """An exchange of balls, centres (B, 3) mm, that a rotation makes good within ``LEAST_DIFFERENCE_MM``; None if there is none."""
    n, apart = len(centres), np.linalg.norm(centres[:, None] - centres, axis=2)
    if n < BALLS_FOR_ORIENTATION:
        return None

    def images(order: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        k = len(order)
        if k == n:
            yield order
            return
        for image in set(range(n)) - set(order):
            same = abs(diameters[image] - diameters[k]) < LEAST_DIFFERENCE_MM
            if same and np.all(np.abs(apart[image, list(order)] - apart[k, :k]) < LEAST_DIFFERENCE_MM):
                yield from images((*order, image))

    for order in images(()):
        if order == tuple(range(n)):
            continue
        a, b = centres - centres.mean(axis=0), centres[list(order)] - centres.mean(axis=0)
        u, s, vt = np.linalg.svd(b.T @ a)
        turned = s @ [1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))]
        if np.sum(a * a) + np.sum(b * b) - 2 * turned < n * LEAST_DIFFERENCE_MM**2:
            return order
    return None


def _balls(count: int) -> str:
    return "one ball" if count == 1 else f"{count} balls"
