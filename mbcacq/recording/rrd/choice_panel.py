"""The panel of an investigation: odds of the explanations, what could still hide, and the poses that were chosen, as they are measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from rerun import escape_entity_path_part as in_path

from mbcacq.recording.rrd import layout

LEAST_ODDS, LARGEST_SIZE = 1e-6, 100.0  # at which the curves end
GHOST = (150, 200, 255, 90)


@dataclass(frozen=True)
class WeighedPoses:
    """What is known before the next poses are measured. sets: explanations with their odds against the first; could_hide: effects with the
    largest size, in usual ones, that is not excluded; looks (k, 2, 3) mm, base frame: from the scanner to what it will look at.
    """

    sets: Sequence[tuple[str, float]]
    could_hide: Sequence[tuple[str, float]]
    looks: np.ndarray


def log_choice(rec: rr.RecordingStream, weighed: WeighedPoses) -> None:
    """Write it at the present times of a stream."""
    for name, odds in weighed.sets:
        rec.log(f"{layout.ODDS}/{in_path(name)}", rr.Scalars(float(np.log10(max(odds, LEAST_ODDS)))))
    for name, size in weighed.could_hide:
        rec.log(f"{layout.COULD_HIDE}/{in_path(name)}", rr.Scalars(float(np.log10(np.clip(size, 1 / LARGEST_SIZE, LARGEST_SIZE)))))
    colors = [GHOST] * len(weighed.looks)
    rec.log(layout.NEXT, rr.LineStrips3D(np.asarray(weighed.looks, dtype=np.float32), colors=colors, radii=2.0))
