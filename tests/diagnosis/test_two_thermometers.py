"""A link grows with the arm's temperature, and the air of the hall warms up alike."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.diagnose import diagnose

GROWTH, WARMS_BY = 0.04, 1 / 7  # mm/K of link 2; what the air warms by for each kelvin of the arm


def found_with(plan, noise_K):
    """What a diagnosis says of the growth when the air, read to ``noise_K``, warms as the arm does."""
    observed = simulated.observe(plan, 11, [("thermal_growth", ("link2",), [GROWTH], None)])
    arm = observed.temperatures["robot_C"]
    air = 20.0 + WARMS_BY * (arm - arm[0]) + np.random.default_rng(1).normal(0.0, noise_K, len(arm))
    found = diagnose(replace(observed, temperatures={"robot_C": arm, "air_C": air}), folds=2)
    (effect,) = found.effects
    assert (effect.name, effect.where) == ("thermal_growth", ("link2",))
    return effect, [note for note in found.notes if note.startswith("thermal_growth at link2 may depend on")]


def test_the_figure_holds_for_the_thermometer_that_is_named_and_the_other_one_is_named_too(plan):
    effect, notes = found_with(plan, 0.0)
    growth = effect.parameters["link2.growth_mm_per_K"]
    per_kelvin = {"robot_C": GROWTH, "air_C": GROWTH / WARMS_BY}
    assert growth.value == pytest.approx(per_kelvin.pop(effect.depends_on), abs=4 * growth.std)
    assert growth.std < 0.1 * growth.value
    assert effect.trend == ""
    (other,) = per_kelvin
    (note,) = notes
    assert note.startswith(f"thermal_growth at link2 may depend on {other} in place of {effect.depends_on} (odds ")


def test_a_thermometer_that_shows_something_else_is_not_named(plan):
    effect, notes = found_with(plan, 1.0)
    growth = effect.parameters["link2.growth_mm_per_K"]
    assert effect.depends_on == "robot_C"
    assert growth.value == pytest.approx(GROWTH, abs=4 * growth.std)
    assert notes == []
