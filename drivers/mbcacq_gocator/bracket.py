"""Several exposures of one pose made into one scan: where one is too dark another is not, and where it glares a shorter one does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbcacq.devices import ProtocolError, Scan

DARK, BRIGHT = 10, 245  # grey values outside are noise or saturation: heights there are poor
_MIDDLE = 128


def usable(scan: Scan) -> int:
    """Points with a grey value the sensor can measure well; all points if the job sends no grey values."""
    if scan.intensity is None:
        return len(scan.points)
    return int(np.count_nonzero((scan.intensity >= DARK) & (scan.intensity <= BRIGHT)))


def best(scans: Sequence[Scan]) -> Scan:
    """The exposure with the most usable points, the first of equals."""
    return max(scans, key=usable)


def merged(scans: Sequence[Scan]) -> Scan:
    """One point a pixel: that of the exposure that sees it with the grey value nearest the middle; without grey values the one of the
    exposure with the most points. The arm must have stood still, so that a pixel is the same place in all of them.

    Time and frame are those of the first exposure, ``exposure_us`` that of the exposure that gave most points. Raises ProtocolError.
    """
    shapes = {scan.shape for scan in scans}
    pixels = [scan.pixel for scan in scans if scan.pixel is not None]
    if len(shapes) != 1 or len(pixels) != len(scans):
        raise ProtocolError(f"exposures of one pose came in different sizes {sorted(shapes)}; merging needs one pixel grid")
    rows, columns = scans[0].shape
    size = rows * columns
    rank = np.argsort(np.argsort([-len(scan.points) for scan in scans], kind="stable"))
    worst = np.full(size, np.inf, np.float32)
    owner = np.full(size, -1, np.int8 if len(scans) < 128 else np.int32)
    for number, (scan, own) in enumerate(zip(scans, pixels, strict=True)):
        grey = scan.intensity
        distance = np.abs(grey.astype(np.float32) - _MIDDLE) if grey is not None else np.full(len(scan.points), rank[number], np.float32)
        better = distance < worst[own]
        owner[own[better]] = number
        worst[own[better]] = distance[better]
    row_of = np.full(size, -1, np.int64)
    pixel = np.flatnonzero(owner >= 0).astype(np.int32)
    points = np.empty((len(pixel), 3), np.float32)
    intensity = np.empty(len(pixel), np.uint8) if all(scan.intensity is not None for scan in scans) else None
    share = []
    for number, (scan, own) in enumerate(zip(scans, pixels, strict=True)):
        mine = owner[pixel] == number
        row_of[own] = np.arange(len(own))
        index = row_of[pixel[mine]]
        points[mine] = scan.points[index]
        if intensity is not None and scan.intensity is not None:
            intensity[mine] = scan.intensity[index]
        share.append(len(index))
    return replace(
        scans[0],
        points=points,
        pixel=pixel,
        intensity=intensity,
        exposure_us=scans[int(np.argmax(share))].exposure_us,
        health=scans[-1].health,
    )
