"""Fitted balls to certificate ids, or a refusal that says what was found and what was expected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.errors import DeviceFault
from mbcacq.model.cell import Artefact
from mbcacq.spheres.fit import SphereFit
from mbcacq.spheres.found import FoundSpheres, Refusals, SphereOptions
from mbcacq.spheres.recognise import Assignment, assignments, decided, prediction_distance, size_classes


def identify_spheres(
    fits: list[tuple[float, SphereFit]],
    refused: Refusals,
    artefact: Artefact,
    expected: Sequence[int] | None,
    predicted: np.ndarray | None,
    options: SphereOptions,
) -> FoundSpheres:
    """See ``mbcacq.spheres.find_spheres``. fits: (radius, fit) of every sphere found."""
    centres = np.array([f.centre for _, f in fits]).reshape(-1, 3)
    radii = np.array([r for r, _ in fits])
    sigma = np.array([np.sqrt(np.trace(f.covariance)) for _, f in fits])
    allowed = np.isclose(radii[:, None], size_classes(artefact.diameters / 2, options.radius_tolerance))
    if expected is not None and len(expected) < 3:
        allowed &= np.isin(artefact.ball_ids, list(expected))
    guess = _guess(artefact, expected, predicted)
    possible = assignments(centres, sigma, allowed, artefact.centres, options)
    refused = list(refused)
    if possible:
        _check_artefact(possible, centres, artefact, expected, options)
    chosen = _choose(possible, centres, artefact, expected, guess, options)
    if chosen is None:
        reason = "its id is undecided: too few balls are in view, and no expected ball or predicted place decides"
        refused += [(reason, centre) for centre in centres]
        return FoundSpheres.of(refused=refused)
    for i in sorted(set(range(len(centres))) - set(chosen.found.tolist())):
        refused.append((f"a ball of {2 * radii[i]:g} mm that does not belong to artefact '{artefact.id}'", centres[i]))
    order = np.argsort(chosen.certified)
    balls = [artefact.ball_ids[a] for a in chosen.certified[order]]
    found = FoundSpheres.of(balls, [fits[i][1] for i in chosen.found[order]], refused)
    for ball in expected or ():
        if ball not in found.ball:
            found.refused.append((f"ball {ball} was expected and is not seen", None))
    return found


def _choose(
    possible: list[Assignment],
    centres: np.ndarray,
    artefact: Artefact,
    expected: Sequence[int] | None,
    guess: np.ndarray | None,
    options: SphereOptions,
) -> Assignment | None:
    """The one assignment that the data, or failing that the prediction, single out; None if nothing does."""
    if not possible:
        return None
    size = len(possible[0].found)
    if size >= 3:
        # a mirror image has the right distances, but no rotation takes it to the certificate
        proper = [p for p in possible if p.rms < max(2 * options.centre_tolerance, 3 * p.mirrored)]
        if not proper:
            raise DeviceFault(
                f"wrong artefact in view: the {size} balls seen are a mirror image of artefact '{artefact.id}' "
                f"(rms {possible[0].rms:.2f} mm as certified, {possible[0].mirrored:.3f} mm mirrored); "
                "put the right artefact in place or correct the certificate"
            )
        alternatives = [p for p in proper[1:] if not decided(proper[0], p, options.centre_sigma)]
        if not alternatives:
            return proper[0]
        possible = [proper[0], *alternatives]
    elif len(possible) == 1 and (size == len(artefact.ball_ids) or expected is not None and size == len(expected)):
        # a single ball where one is expected, or two of different diameters
        if guess is None or len(centres) == 1:
            return possible[0]
    if guess is not None:
        distances = [prediction_distance(p, centres, guess) for p in possible]
        order = np.argsort(distances)
        if np.isfinite(distances[order[0]]) and (len(distances) == 1 or distances[order[0]] < 0.5 * distances[order[1]]):
            return possible[order[0]]
    if size >= 3:
        raise DeviceFault(
            f"cannot tell which ball is which: the {size} balls seen fit artefact '{artefact.id}' in {len(possible)} ways; "
            "show more of its balls, or use an artefact without symmetry"
        )
    return None


def _check_artefact(
    possible: list[Assignment], centres: np.ndarray, artefact: Artefact, expected: Sequence[int] | None, options: SphereOptions
) -> None:
    """Raise unless most of the balls seen are at distances that the certificate knows."""
    n, k = len(centres), len(possible[0].found)
    if k < 3:
        fits = k == min(n, len(artefact.ball_ids if expected is None else expected))
    else:
        # three distances agree by coincidence more easily than six, so they must agree better
        rms = min(min(p.rms, p.mirrored) for p in possible)
        fits = 2 * k > n and rms < options.centre_tolerance * (0.4 if k == 3 else 1.0)
    if not fits:
        raise DeviceFault(
            f"wrong artefact in view: {n} balls with the distances {_distances(centres)} mm are seen, "
            f"of which at most {k} fit artefact '{artefact.id}' with {_distances(artefact.centres)} mm; "
            "put the right artefact in place or correct the plan"
        )


def _distances(centres: np.ndarray) -> str:
    i, j = np.triu_indices(len(centres), 1)
    values = np.sort(np.linalg.norm(centres[i] - centres[j], axis=1))
    return ", ".join(f"{d:.2f}" for d in values[:6]) + (" ..." if len(values) > 6 else "") if len(values) else "(none)"


def _guess(artefact: Artefact, expected: Sequence[int] | None, predicted: np.ndarray | None) -> np.ndarray | None:
    """(B, 3) predicted places in the order of the certificate, NaN where there is none."""
    if predicted is None:
        return None
    out = np.full((len(artefact.ball_ids), 3), np.nan)
    for ball, place in zip(artefact.ball_ids if expected is None else expected, predicted, strict=True):
        out[artefact.ball_ids.index(ball)] = place
    return out
