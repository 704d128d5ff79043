"""Uncertainty of judging a length with the cell: certificate, temperature of the artefact, probing of spheres, repeatability of the arm.

The judged quantity, the error of the calibrated cell, is no part of the uncertainty of judging it (ISO 14253-1): the covariance of the
calibration does not enter here. Every term is a standard uncertainty along the length; they are independent, and add as squares.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import computed_field

from mbcacq.model.cell import Artefact
from mbcacq.model.observations import Observations

ASSUMED_ROOM_C = (15.0, 25.0)  # of a workshop without air conditioning, where nothing was measured or stated
STEEL_PPM_PER_K = 11.5  # of an artefact whose expansion its file does not state; few that are sold expand more
THERMOMETER_C = 0.5  # standard uncertainty of an industrial sensor on the artefact
AIR_C = 1.0  # of taking the air's temperature for the artefact's, which follows it late
ROOM_NAMES = ("air", "room", "ambient", "hall", "environment")
DATA_SHEET_SIGMAS = 3.0  # pose repeatability RP of ISO 9283 is the mean plus three standard deviations


@dataclass(frozen=True)
class Temperature:
    """The temperature of an artefact while it was measured, and its uncertainty.

    low_C, high_C: range; sensor_C: standard uncertainty of reading it there; source: 'measured', 'stated' or 'assumed'; what: the sensor
    or where the range comes from, in words; reference_C: temperature of the certificate; expansion_ppm_per_K: 1e-6/K, which is assumed
    where the artefact's file does not state it.
    """

    low_C: float
    high_C: float
    sensor_C: float
    source: str
    what: str
    reference_C: float
    expansion_ppm_per_K: float
    expansion_stated: bool

    @property
    def deviation_K(self) -> float:
        """Root mean square distance from the reference temperature, anything within the range being as likely: an offset that is not
        corrected counts in full (GUM, F.2.4.5)."""
        middle = 0.5 * (self.low_C + self.high_C) - self.reference_C
        return float(np.sqrt(middle**2 + (self.high_C - self.low_C) ** 2 / 12 + self.sensor_C**2))

    def thermal_mm(self, length_mm: float) -> float:
        """Standard uncertainty (mm) of a certified length by the temperature of its artefact."""
        return 1e-6 * abs(self.expansion_ppm_per_K) * length_mm * self.deviation_K


@dataclass(frozen=True)
class LengthBudget:
    """Standard uncertainties (mm) of judging one length of length_mm at a station, and what is known of the temperature there."""

    length_mm: float
    certificate_mm: float
    temperature_mm: float
    probing_mm: float
    repeatability_mm: float
    station: str
    temperature: Temperature

    @computed_field
    @property
    def combined_mm(self) -> float:
        terms = self.certificate_mm, self.temperature_mm, self.probing_mm, self.repeatability_mm
        return float(np.sqrt(np.sum(np.square(terms))))


def artefact_temperature(obs: Observations, artefact: Artefact) -> Temperature:
    """The temperature of an artefact over the poses of ``obs``: from a sensor on it, of the air, from the stated range of the room, or
    assumed, in this order.

    A temperature belongs to the artefact where its column (``NAME_C``) names the artefact's id or begins with 'artefact'; to the air where
    it names air, room, ambient or hall.
    """
    columns = {name: values[np.isfinite(values)] for name, values in obs.temperatures.items()}
    columns = {name: values for name, values in columns.items() if len(values)}

    def known(low_C: float, high_C: float, sensor_C: float, source: str, what: str) -> Temperature:
        ppm = artefact.expansion_ppm_per_K
        certified = float(artefact.reference_temperature_C), STEEL_PPM_PER_K if ppm is None else ppm, ppm is not None
        return Temperature(float(low_C), float(high_C), sensor_C, source, what, *certified)

    for name, values in columns.items():
        words = name.lower().removesuffix("_c").split("_")
        if artefact.id.lower() in words or words[0] == "artefact":
            return known(values.min(), values.max(), THERMOMETER_C, "measured", name)
    for name, values in columns.items():
        if set(name.lower().split("_")) & set(ROOM_NAMES):
            return known(values.min(), values.max(), AIR_C, "measured", name)
    if obs.cell.room_temperature_C is not None:
        return known(*obs.cell.room_temperature_C, 0.0, "stated", "room_temperature_C")
    return known(*ASSUMED_ROOM_C, 0.0, "assumed", "no temperature was measured or stated")


def length_budget(obs: Observations, station: int, balls: tuple[int, int], ends: Sequence[tuple[float, float, float]] = ()) -> LengthBudget:
    """The budget of the length between two balls of a station.

    Parameters
    ----------
    obs
        The poses verified on.
    station
        Index of the station.
    balls
        Ids of the two balls.
    ends
        For each ball the variances (mm^2), along the length, of one measurement by the scanner and by the joints, and the number of poses
        averaged over; without them probing and repeatability are not known and count as zero.
    """
    artefact = obs.cell.artefact(obs.cell.stations[station].artefact)
    a, b = (artefact.centres[artefact.ball_ids.index(ball)] for ball in balls)
    length = float(np.linalg.norm(a - b))
    probing = sum(seen / poses for seen, _, poses in ends)
    repeatability = sum(repeated_variance(obs, moved) / poses for _, moved, poses in ends)
    temperature = artefact_temperature(obs, artefact)
    return LengthBudget(
        length_mm=length,
        certificate_mm=float(np.sqrt(2) * artefact.uncertainty_mm),
        temperature_mm=temperature.thermal_mm(length),
        probing_mm=float(np.sqrt(probing)),
        repeatability_mm=float(np.sqrt(repeatability)),
        station=obs.cell.stations[station].id,
        temperature=temperature,
    )


def repeated_variance(obs: Observations, found_mm2: float) -> float:
    """Variance (mm^2) of one end by the arm's repeatability: as the recording shows it, but no more than the pose repeatability of the data
    sheet, if stated. Lacks of a model may look like scatter of the joints, and must not widen the uncertainty by which it is judged.
    """
    if obs.cell.robot.repeatability_mm is None:
        return found_mm2
    stated = (obs.cell.robot.repeatability_mm / DATA_SHEET_SIGMAS) ** 2
    return min(found_mm2, stated) if found_mm2 > 0 else stated


def temperature_sentence(budget: Mapping[str, Any]) -> str:
    """The artefact's temperature in a budget, as a person reads it."""
    t = budget["temperature"]
    low, high = f"{t['low_C']:.3g}", f"{t['high_C']:.3g}"
    span = f"{low} °C" if low == high else f"{low} to {high} °C"
    how = {
        "measured": f"measured ({t['what']}), {span}",
        "stated": f"stated for the room, {span}",
        "assumed": f"not known: {span} is assumed (state room_temperature_C, or measure it)",
    }[t["source"]]
    steel = "" if t["expansion_stated"] else ", steel is assumed"
    return f"{how}; certified at {t['reference_C']:g} °C, {t['expansion_ppm_per_K']:g} ppm/K{steel}"
