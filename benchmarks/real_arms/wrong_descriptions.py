"""Mistakes in the description of a recording: are they named?"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbcacq.calibration.description import wrong_descriptions
from mbcacq.model.observations import Observations
from mbcacq.recording import load_observations

CALL = "python benchmarks/real_arms.py wrong-descriptions"
Mistake = Callable[[Observations], Observations]


FIRST, SECOND, THIRD = "ur10-tracker-c", "ur5-tracker", "example-none"


def reversed_axis(j: int) -> Mistake:
    return lambda o: replace(o, q=o.q * np.where(np.arange(o.q.shape[1]) == j, -1.0, 1.0))


def offset(j: int, degrees: float) -> Mistake:
    return lambda o: replace(o, q=o.q + np.radians(degrees) * np.eye(o.q.shape[1])[j])


def exchanged(i: int, j: int) -> Mistake:
    def mistake(o: Observations) -> Observations:
        order = np.arange(o.q.shape[1])
        order[[i, j]] = j, i
        return replace(o, q=o.q[:, order])

    return mistake


def points(factor: float | list[float]) -> Mistake:
    return lambda o: replace(o, xyz=o.xyz * factor)


def point_columns(*order: int) -> Mistake:
    """The file has the columns in this order."""
    return lambda o: replace(o, xyz=o.xyz[:, np.argsort(order)])


def in_radians(o: Observations) -> Observations:
    return replace(o, q=np.radians(o.q))


def left_handed(o: Observations) -> Observations:
    assert o.rotation is not None
    mirror = np.diag([1.0, -1.0, 1.0])
    return replace(o, rotation=mirror @ o.rotation @ mirror)


def inverted(o: Observations) -> Observations:
    assert o.rotation is not None
    return replace(o, rotation=np.swapaxes(o.rotation, 1, 2))


def certified_mirrored(o: Observations) -> Observations:
    artefacts = tuple(replace(a, centres=a.centres * [1, -1, 1]) for a in o.cell.artefacts)
    return replace(o, cell=replace(o.cell, artefacts=artefacts))


def counted_from_the_horizontal(o: Observations) -> Observations:
    q = o.q.copy()
    q[:, 2] += q[:, 1]
    return replace(o, q=q)


CASES: tuple[tuple[str, str, Mistake, str], ...] = (
    (FIRST, "A6 counted the other way round", reversed_axis(5), "A6 reversed"),
    (FIRST, "A3 counted the other way round", reversed_axis(2), "A3 reversed"),
    (FIRST, "A2 90 deg off", offset(1, 90), "-90° added to A2"),
    (FIRST, "A4 180 deg off", offset(3, 180), "+180° added to A4"),
    (FIRST, "angles in radians", in_radians, "the angles read as radians, not degrees (are the columns q1_rad .. and not q1_deg ..?)"),
    (FIRST, "points in metres", points(1e-3), "the measured points read as metres, not millimetres"),
    (FIRST, "orientation left-handed", left_handed, "the orientation mirrored along y (left-handed)"),
    (FIRST, "orientation inverted", inverted, "the orientation inverted"),
    (FIRST, "columns of A4 and A5 exchanged", exchanged(3, 4), "the columns of A4 and A5 exchanged"),
    (FIRST, "y of the points reversed", points([1, -1, 1]), "y of the measured points reversed"),
    (SECOND, "A1 counted the other way round", reversed_axis(0), "A1 reversed"),
    (SECOND, "A5 90 deg off", offset(4, -90), "+90° added to A5"),
    (SECOND, "points in metres", points(1e-3), "the measured points read as metres, not millimetres"),
    (SECOND, "columns x and y exchanged", point_columns(1, 0, 2), "the columns of the measured points read as y, x, z"),
    (SECOND, "columns of A2 and A3 exchanged", exchanged(1, 2), "the columns of A2 and A3 exchanged"),
    (SECOND, "A3 counted from the horizontal", counted_from_the_horizontal, "A2 subtracted from A3, which is counted from the horizontal"),
    (THIRD, "A4 counted the other way round", reversed_axis(3), "A4 reversed"),
    (THIRD, "y of the certified centres reversed", certified_mirrored, "y of the certified centres reversed"),
    (THIRD, "columns of the points x, z, y", point_columns(0, 2, 1), "the columns of the measured points read as x, z, y"),
    (THIRD, "A3 90 deg off", offset(2, -90), "+90° added to A3"),
)


def descriptions(given: argparse.Namespace) -> None:
    """Twenty wrong descriptions of three measured recordings: is the mistake named?

    A mistake is made in the arrays (angles, points, orientation, cell), then sought by ``mbcacq.calibration.description`` with its quick
    fit. It counts as named when the first change offered, or one said to fit as well, undoes it; a recording as it is must be left alone.
    Prints the page.
    """
    recordings = {name: load_observations(given.data / name) for name in (FIRST, SECOND, THIRD)}
    print("# Wrong descriptions\n\n**Question.** Is a mistake in the description of a recording named?\n")
    print(f"    {CALL} > benchmarks/wrong_descriptions.md\n")
    print("| recording | mistake | residual with it, without, mm | named | alike |\n|---|---|---|---|--:|")
    right = 0
    for name, what, mistake, undo in CASES:
        found = wrong_descriptions(mistake(recordings[name]))
        named = bool(found) and undo in (found[0].what, *found[0].alternatives)
        right += named
        first = f"{found[0].before_mm:.3g}, {found[0].after_mm:.3g}" if found else "nothing found"
        alike = len(found[0].alternatives) if found else ""
        print(f"| {name} | {what} | {first} | {'yes' if named else 'no'} | {alike or ''} |", flush=True)
    clean = [name for name, o in recordings.items() if wrong_descriptions(o)]
    print(
        "\nAlike: other changes that the data cannot tell from it. Positions alone do not tell one mirror from another: a reversed "
        "coordinate and two exchanged columns differ by a rotation, which the pose of the station or the scanner absorbs."
    )
    print(f"\n{right} of {len(CASES)} named; of the {len(recordings)} recordings as they are, {len(clean)} were suspected.")
