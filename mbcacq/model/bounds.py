"""What a physical quantity of a plan, robot, artefact, scanner or cell file can be: one table of unit, range and reason.

The ranges keep out slips and damage (1e20, a mass below zero), not bad cells: what is merely unusual passes here and is judged where it
matters. A value that is no finite number never gets this far: ``Strict`` and the YAML reader refuse it.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from mbcacq.errors import ConfigError


class Bound(NamedTuple):
    """A range that includes its ends; ``above``: its low end is left out."""

    unit: str
    low: float
    high: float
    reason: str
    above: bool = False


BOUNDS = {
    "position": Bound("mm", -1e6, 1e6, "a kilometre: no cell is longer, no tracker reaches so far"),
    "length": Bound("mm", 0, 1e6, "as a position", above=True),
    "distance": Bound("mm", 0, 1e6, "as a position; zero is meant"),
    "radius": Bound("mm", 0, 1e4, "10 m: the upper arm of the largest robots is below 1 m thick", above=True),
    "gap": Bound("mm", 0, 1e4, "10 m: clearances and stands are smaller"),
    "error": Bound("mm", 0, 1e3, "1 m: a tolerance beyond it asks for nothing", above=True),
    "uncertainty": Bound("mm", 0, 1e3, "1 m: anything larger is not known at all; zero: nothing is stated"),
    "repeatability": Bound("mm", 0, 10, "10 mm: arms are stated with 0.005 to 1 mm", above=True),
    "noise": Bound("mm", 0, 10, "10 mm: what is worse tells no ball of an artefact from the next"),
    "resolution": Bound("mm", 0.03, 100, "a voxel filter of less takes hours, one of more shows no ball", above=True),
    "angle": Bound("deg", -3600, 3600, "ten turns: an orientation needs half of one"),
    "joint_angle": Bound("deg", -36_000, 36_000, "a hundred turns of an axis without end"),
    "angle_noise": Bound("deg", 0, 45, "45 deg: beyond it an orientation is not measured", above=True),
    "speed": Bound("deg/s", -1e4, 1e4, "28 turns a second; wrists reach 1000 deg/s"),
    "acceleration": Bound("deg/s2", -1e7, 1e7, "a wrist's largest speed in 1 ms"),
    "jerk": Bound("deg/s3", -1e10, 1e10, "that acceleration in 1 ms"),
    "linear_speed": Bound("mm/s", -1e5, 1e5, "100 m/s: gantries and tracks reach 5 m/s"),
    "linear_acceleration": Bound("mm/s2", -1e7, 1e7, "a thousand g"),
    "linear_jerk": Bound("mm/s3", -1e10, 1e10, "that acceleration in 1 ms"),
    "gear_ratio": Bound("1", -1e5, 1e5, "robots have 30 to 300"),
    "coupling": Bound("1", -100, 100, "an axis that drags another moves it about as far as itself"),
    "pulses": Bound("1/deg", -1e9, 1e9, "an encoder of 32 bit behind a gear of 100"),
    "mass": Bound("kg", 0, 1e5, "100 t: the heaviest arms weigh 10 t"),
    "payload": Bound("kg", 0, 5000, "what the largest arms carry, and more"),
    "temperature": Bound("C", -40, 80, "a place where a robot works"),
    "expansion": Bound("ppm/K", -100, 1000, "carbon fibre has -1, steel 11, plastics up to 300"),
    "direction": Bound("1", -1e6, 1e6, "the length of a direction is not used"),
    "cosine": Bound("1", -2, 2, "an element of a rotation matrix is at most 1"),
}


def refuse_beyond(quantity: str, values: Any, what: str) -> None:
    """Raises ConfigError for the first of some numbers from a foreign file that is none, or beyond the range of its quantity.

    Parameters
    ----------
    quantity
        Key of ``BOUNDS``; ``values`` are in its unit.
    what
        File and thing, in the sentence.
    """
    bound, numbers = BOUNDS[quantity], np.ravel(values)
    inside = (numbers >= bound.low) & (numbers <= bound.high)
    if not inside.all():
        possible = f"{bound.low:g} to {bound.high:g} {bound.unit.removeprefix('1')}".rstrip()
        raise ConfigError(f"{what} is {numbers[~inside][0]:g}, where {possible} is possible; correct the numbers in the file")


def _within(name: str) -> Any:
    bound = BOUNDS[name]
    return Field(gt=bound.low, le=bound.high) if bound.above else Field(ge=bound.low, le=bound.high)


Position = Annotated[float, _within("position")]
Length = Annotated[float, _within("length")]
Distance = Annotated[float, _within("distance")]
Radius = Annotated[float, _within("radius")]
Gap = Annotated[float, _within("gap")]
Error = Annotated[float, _within("error")]
Uncertainty = Annotated[float, _within("uncertainty")]
Repeatability = Annotated[float, _within("repeatability")]
Noise = Annotated[float, _within("noise")]
Resolution = Annotated[float, _within("resolution")]
Angle = Annotated[float, _within("angle")]
JointAngle = Annotated[float, _within("joint_angle")]
AngleNoise = Annotated[float, _within("angle_noise")]
Speed = Annotated[float, _within("speed")]
Acceleration = Annotated[float, _within("acceleration")]
Jerk = Annotated[float, _within("jerk")]
LinearSpeed = Annotated[float, _within("linear_speed")]
LinearAcceleration = Annotated[float, _within("linear_acceleration")]
LinearJerk = Annotated[float, _within("linear_jerk")]
GearRatio = Annotated[float, _within("gear_ratio")]
CouplingFactor = Annotated[float, _within("coupling")]
Pulses = Annotated[float, _within("pulses")]
Mass = Annotated[float, _within("mass")]
PayloadMass = Annotated[float, _within("payload")]
RoomTemperature = Annotated[float, _within("temperature")]
Expansion = Annotated[float, _within("expansion")]
_Component = Annotated[float, _within("direction")]
_Cosine = Annotated[float, _within("cosine")]

Place = tuple[Position, Position, Position]  # mm
Angles = tuple[Angle, Angle, Angle]  # deg
Direction = tuple[_Component, _Component, _Component]
RotationRow = tuple[_Cosine, _Cosine, _Cosine]
