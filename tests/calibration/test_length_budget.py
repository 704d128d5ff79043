"""The uncertainty by which a length is judged: every term by hand."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from mbcacq.calibration.length_budget import LengthBudget, artefact_temperature, repeated_variance, temperature_sentence
from mbcacq.calibration.verification import verdict_of_places
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Artefact, Cell, RobotModel, Station
from mbcacq.model.cell_schema import TemperatureRange
from mbcacq.model.observations import Observations

CHAIN = Chain(np.ones(6), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6))
STEEL = Artefact("bar", "bar", (1, 2), np.array([[0.0, 0, 0], [735.0, 0, 0]]), np.full(2, 25.0), expansion_ppm_per_K=11.5)


def observations(temperatures=None, room=None, artefact=STEEL, repeatability=None):
    robot = RobotModel("arm", CHAIN, np.full((6, 2), [-3.0, 3.0]), np.zeros(6), np.zeros((6, 3)), repeatability_mm=repeatability)
    cell = Cell(robot, np.eye(4), (artefact,), (Station("b1", "bar"),), room_temperature_C=room)
    none = np.zeros(0, dtype=int)
    return Observations(
        cell, np.arange(3), np.zeros(3, int), np.zeros((3, 6)), none, none, np.zeros((0, 3)), temperatures=temperatures or {}
    )


def thermal(obs):
    return artefact_temperature(obs, obs.cell.artefacts[0]).thermal_mm(735.0)


def test_steel_grows_by_eight_and_a_half_micrometres_a_kelvin_over_the_bar():
    """Exactly one kelvin above its reference temperature, known exactly: 11.5e-6 x 735 mm."""
    assert thermal(observations(room=(21.0, 21.0))) == pytest.approx(11.5e-6 * 735.0)


def test_a_stated_range_counts_as_a_rectangle_and_its_offset_in_full():
    # 18 to 26 C: middle 2 K above 20 C, half width 4 K: sqrt(2^2 + 8^2 / 12)
    assert thermal(observations(room=(18.0, 26.0))) == pytest.approx(11.5e-6 * 735.0 * np.sqrt(4 + 64 / 12))


def test_an_unknown_temperature_assumes_a_workshop_and_says_so():
    obs = observations()
    assert thermal(obs) == pytest.approx(11.5e-6 * 735.0 * 10 / np.sqrt(12))
    assert artefact_temperature(obs, STEEL).source == "assumed"


def test_a_sensor_on_the_artefact_counts_before_the_air_and_the_statement():
    measured = {"air_C": np.array([22.0, 24.0, 23.0]), "bar_C": np.array([20.0, 20.0, 20.0])}
    found = artefact_temperature(observations(measured, room=(0.0, 40.0)), STEEL)
    assert (found.what, found.low_C, found.high_C) == ("bar_C", 20.0, 20.0)
    found = artefact_temperature(observations({"air_C": measured["air_C"], "robot_C": np.full(3, 40.0)}, room=(0.0, 40.0)), STEEL)
    assert (found.source, found.low_C, found.high_C) == ("measured", 22.0, 24.0)
    # The motor's temperature says nothing about the artefact's; neither does a sensor that gave no value.
    assert artefact_temperature(observations({"robot_C": np.full(3, 40.0)}), STEEL).source == "assumed"
    assert artefact_temperature(observations({"air_C": np.full(3, np.nan)}), STEEL).source == "assumed"


def test_an_artefact_of_unknown_expansion_is_taken_for_steel():
    unknown = replace(STEEL, expansion_ppm_per_K=None)
    assert thermal(observations(room=(21.0, 21.0), artefact=unknown)) == thermal(observations(room=(21.0, 21.0)))


def test_terms_add_as_squares():
    somewhere = "b1", artefact_temperature(observations(), STEEL)
    assert LengthBudget(735.0, 0.003, 0.004, 0.012, 0.084, *somewhere).combined_mm == pytest.approx(np.sqrt(9 + 16 + 144 + 7056) * 1e-3)


def test_what_a_model_lacks_does_not_widen_what_it_is_judged_by():
    """Scatter of the joints beyond the data sheet is misfit: the guard band stays that of an arm which repeats within 0.03 mm."""
    obs = observations(repeatability=0.03)
    assert repeated_variance(obs, 0.05**2) == pytest.approx(0.01**2)
    assert repeated_variance(obs, 0.004**2) == pytest.approx(0.004**2)
    assert repeated_variance(obs, 0.0) == pytest.approx(0.01**2)  # the recording shows none: the data sheet's
    assert repeated_variance(observations(), 0.05**2) == pytest.approx(0.05**2)


@pytest.mark.parametrize(
    ("errors", "sigma", "verdict"),
    [
        ([0.05, -0.08], [0.005, 0.009], "pass"),
        ([0.05, -0.085], [0.005, 0.009], "undecided"),  # 0.085 + 0.018 > 0.1
        ([0.05, -0.115], [0.005, 0.009], "undecided"),
        ([0.05, -0.119], [0.005, 0.009], "fail"),
        ([0.111, 0.05], [0.005, 0.009], "fail"),  # each place with its own uncertainty
    ],
)
def test_every_place_is_held_against_the_limit_with_its_own_uncertainty(errors, sigma, verdict):
    assert verdict_of_places(np.array(errors), sigma, 0.1) == verdict


def test_a_range_of_the_room_is_read_checked_and_kept():
    from mbcacq.recording.datasets.cell_yaml import cell_to_yaml, parse_cell

    cell = observations(room=(18.5, 23.0)).cell
    assert parse_cell(cell_to_yaml(cell)).room_temperature_C == (18.5, 23.0)
    assert TypeAdapter(TemperatureRange).validate_python([18, 23]) == (18.0, 23.0)
    for wrong in ([25, 18], [18], [18, 200]):
        with pytest.raises(ValidationError):
            TypeAdapter(TemperatureRange).validate_python(wrong)


def test_the_sentence_says_what_is_assumed():
    temperature = {"low_C": 15.0, "high_C": 25.0, "source": "assumed", "what": "", "reference_C": 20.0}
    said = temperature_sentence({"temperature": temperature | {"expansion_ppm_per_K": 11.5, "expansion_stated": False}})
    assert said == (
        "not known: 15 to 25 °C is assumed (state room_temperature_C, or measure it); certified at 20 °C, 11.5 ppm/K, steel is assumed"
    )
