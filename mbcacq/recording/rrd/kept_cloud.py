"""What of a cloud is kept in a recording: the points of the balls, and a thinned rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.devices import Scan
from mbcacq.model.cell import Artefact

AROUND_MM = 2.0  # points this near to a certified sphere are kept: more than any search for the ball looks at
FURTHER_PER_BALL = 60  # of the exposures after the first of a pose: enough to see that they agree
REST, FURTHER_REST = 1000, 100  # of what is on no ball: enough to see what stood there


def kept_cloud(scan: Scan, artefact: Artefact, ball: np.ndarray, centre: np.ndarray, exposure: int) -> Scan:
    """The scan with every point near the balls that were found, and an even choice of the others; a pose's further exposures have an even
    choice of both.

    Parameters
    ----------
    scan
        As the scanner sent it.
    artefact, ball, centre
        What was found: ids (k,) of the artefact's balls, and centres (k, 3) mm in the scanner frame.
    exposure
        Number within the pose, from 0.

    Returns
    -------
    Scan of some of the points, in their order; all of them where no ball was found, for whoever asks why.
    """
    if not len(ball):
        return scan
    radius = dict(zip(artefact.ball_ids, artefact.diameters / 2, strict=True))
    keep = np.zeros(len(scan.points), dtype=bool)
    on_a_ball = np.zeros(len(scan.points), dtype=bool)
    for number, middle in zip(np.asarray(ball).tolist(), np.asarray(centre, dtype=float), strict=True):
        reach = float(radius[number]) + AROUND_MM
        near = np.flatnonzero(np.abs(scan.points[:, 0] - middle[0]) < reach)
        near = near[np.linalg.norm(scan.points[near] - middle, axis=1) < reach]
        on_a_ball[near] = True
        keep[near if exposure == 0 else _even(near, FURTHER_PER_BALL)] = True
    keep[_even(np.flatnonzero(~on_a_ball), REST if exposure == 0 else FURTHER_REST)] = True
    some = {name: None if value is None else value[keep] for name in ("intensity", "pixel") for value in [getattr(scan, name)]}
    return replace(scan, points=scan.points[keep], **some)


def _even(index: np.ndarray, most: int) -> np.ndarray:
    """At most ``most`` of some indices, evenly spread."""
    return index[:: -(-len(index) // most)] if len(index) > most else index
