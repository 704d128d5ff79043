"""A change at a moment of a recording as it is said: what, when, by how much, and what to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.model.cell import axis_of_tag
from mbcacq.model.json_text import AsJson
from mbcacq.quantities import in_degrees

UNDETERMINED = 1e6  # mm, rad or ppm, standard deviation of a component that poses say nothing of: a bar's rotation about itself


@dataclass(frozen=True)
class ChangeFound(AsJson):
    """A change at a moment of a recording.

    Attributes
    ----------
    kind, where : str
        'mount', 'scanner', 'scale', 'joint', 'station' or 'ball'; which one, '' if there is one only.
    before, after : int
        Numbers of the poses, as recorded, between which it happened; a range where several moments are as probable.
    nth, poses, station : int, int, str
        The most probable first pose after it, counted from 1 in the order of measuring, of how many; the station of that pose.
    seconds : float or None
        Time from the first pose to that pose.
    components, units : tuple of str
        Names of the parts of the step.
    value, std : tuple of float
        Estimate and standard deviation of each.
    log_e : float
        Logarithm of the e-value of all changes.
    or_else : tuple of str
        Other kinds that explain it as well.
    hand_eye_before, hand_eye_after : tuple
        Rows of T_flange_scanner (mm) by a model with the change; the same where it is not the mount that changed.
    hand_eye_std : tuple of float
        Six standard deviations of its twist, mm and rad, before the change.
    """

    kind: str
    where: str
    before: int
    after: int
    nth: int
    poses: int
    station: str
    seconds: float | None
    components: tuple[str, ...]
    units: tuple[str, ...]
    value: tuple[float, ...]
    std: tuple[float, ...]
    log_e: float
    or_else: tuple[str, ...]
    hand_eye_before: tuple[tuple[float, ...], ...]
    hand_eye_after: tuple[tuple[float, ...], ...]
    hand_eye_std: tuple[float, ...]

    @property
    def event(self) -> str:
        """What changed, when and by how much, and what to do."""
        what, to_do = in_words(self.kind, self.where)
        at = f"pose {self.nth} of {self.poses} in the order of measuring, at station {self.station}"
        when = "" if self.seconds is None else f", {self.seconds:.0f} s after the first"
        stated = zip(self.components, *_shown(self), self.std, strict=True)
        sizes = [f"{n} {v:+.4f} ± {2 * s:.4f} {u}" if std < UNDETERMINED else f"{n} not determined" for n, v, s, u, std in stated]
        other = f" ({' or '.join(in_words(*one.split(':'))[0] for one in self.or_else)} explains it as well)" if self.or_else else ""
        happened = f"{what} between pose {self.before} and pose {self.after}{other}; {to_do}"
        return f"{happened}. First after it: {at}{when}. Size (k = 2): {', '.join(sizes)}"

    @property
    def sentence(self) -> str:
        """The event, and the hand-eye transform before and after it."""
        was, now = (", ".join(f"{row[3]:.4f}" for row in T[:3]) for T in (self.hand_eye_before, self.hand_eye_after))
        result = f"{was} mm before and {now} mm after it" if was != now else f"{was} mm with the change in the model"
        return f"{self.event}. The values printed average over it: the hand-eye transform has X, Y, Z = {result}"


def _shown(change: ChangeFound) -> tuple[np.ndarray, np.ndarray, list[str]]:
    factor = np.array([in_degrees(1.0) if u == "rad" else 1.0 for u in change.units])
    return factor * change.value, factor * change.std, ["°" if u == "rad" else u for u in change.units]


def in_words(kind: str, where: str) -> tuple[str, str]:
    """What a kind of change is called, and what to do."""
    return {
        "mount": ("the scanner's mount slipped", "fasten it and measure anew"),
        "scanner": ("the scanner's mount slipped, or the scanner's coordinates shifted,", "fasten it and measure anew"),
        "scale": ("the scale of the scanner's coordinates changed", "look at its settings and its temperature, and measure anew"),
        "joint": (f"the zero of joint {axis_of_tag(where)} stepped", "check its mastering"),
        "station": (f"the place of the artefact at station {where} changed", "measure that station anew"),
        "ball": (f"ball {where} moved on its artefact", "look at the artefact, and measure anew"),
    }[kind]
