"""Accuracy on held-out poses: the figure that judges a model.

'random' and 'block': stations keep their pose from the training poses; the figure is the 3D distance of measured and predicted centres.
'station': a whole placement is left out. Its own pose is unknown and fitted to the held-out poses alone, the geometry fixed. The figure is
their spread about it, with the six (or fewer) degrees of freedom that this fit takes accounted for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.held_out_poses import ball_spread, gross, held_out_masks, predicted, rms
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions, select_phases
from mbcacq.model.json_text import AsJson
from mbcacq.model.observations import Observations

SPLITS = ("station", "random", "block")


@dataclass(frozen=True, kw_only=True)
class HeldOut(AsJson):
    """Errors of held-out centres.

    Attributes
    ----------
    split : str
        How centres were held out.
    fits : int
        Number of fits.
    poses, centres : int
        Held out in total.
    rms_mm : float
        3D rms of all held-out centres, freedom of refitted stations accounted for.
    spread_mm : float or None
        ('station' only) 3D rms distance of each ball, brought into the base, from its own mean place; no certificate enters and no freedom
        is accounted for.
    median_mm, max_mm : float
        Median and largest of the distances behind rms_mm.
    gross : int
        Centres beyond 10 medians of their fit.
    rms_without_gross_mm : float
        The robust figure: 3D rms without these centres.
    per_fit_mm : tuple[float, ...]
        3D rms of each fit.
    """

    split: str
    fits: int
    poses: int
    centres: int
    rms_mm: float
    spread_mm: float | None
    median_mm: float
    max_mm: float
    gross: int
    rms_without_gross_mm: float
    per_fit_mm: tuple[float, ...]
    seed: int


def held_out(
    observations: Observations,
    options: CalibrationOptions | None = None,
    split: str = "random",
    *,
    size: int | None = None,
    fits: int | None = None,
    seed: int = 0,
) -> HeldOut:
    """Fit again and again without some poses, and predict those.

    size: poses held out of each random fit (default 30 %, at most 300). fits: 3 random ones, 5 blocks, or every station once.
    Raises ConfigError for an unknown split, CalibrationError if too little is left to fit.
    """
    options = options or CalibrationOptions()
    if split not in SPLITS:
        raise ConfigError(f"there is no held-out split '{split}'; give one of {', '.join(SPLITS)}")
    obs = select_phases(observations, options)
    masks = held_out_masks(obs, split, size, fits, seed)
    distances, freedom, each, scatter = [], 0, [], []
    for test in masks:
        fitted, held = calibrate(obs.select(~test), options), obs.select(test)
        d, used = predicted(held, fitted, split == "station")
        if split == "station":
            scatter.append(ball_spread(held, fitted))
        distances.append(d)
        freedom += used
        each.append(rms(d, used))
    d, kept = np.concatenate(distances), np.concatenate([~gross(part) for part in distances])
    return HeldOut(
        split=split,
        fits=len(masks),
        poses=int(sum(m.sum() for m in masks)),
        centres=len(d),
        rms_mm=rms(d, freedom),
        spread_mm=rms(np.concatenate(scatter)) if scatter else None,
        median_mm=float(np.median(d)),
        max_mm=float(d.max()),
        gross=int(np.sum(~kept)),
        rms_without_gross_mm=rms(d[kept], freedom),
        per_fit_mm=tuple(each),
        seed=seed,
    )
