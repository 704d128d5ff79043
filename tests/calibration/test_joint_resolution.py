"""Joint angles that somebody rounded: seen in every recording that is read, said with the place where it is set, counted as noise."""

from dataclasses import replace

import numpy as np
import pytest
from cells import scanner_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.estimation.variance_components import first_noise, noise_prior
from mbcacq.model.joint_resolution import joint_step
from mbcacq.recording import load_observations
from mbcacq.recording.datasets.observation_set import write_observation_set

RNG = np.random.default_rng(7)
ANGLES = RNG.uniform(-90, 90, (30, 6))


@pytest.mark.parametrize("decimals", [1, 2, 3])
def test_rounded_angles_are_seen_whatever_was_done_to_them_since(decimals):
    rounded = np.radians(np.round(ANGLES, decimals))
    step = np.radians(10.0**-decimals)
    assert joint_step(rounded) == pytest.approx(step)
    assert joint_step(np.radians(np.degrees(rounded))) == pytest.approx(step)
    flickering = np.where(RNG.random(rounded.shape) < 0.15, rounded + 0.3 * step, rounded)  # means between two steps
    assert joint_step(flickering) == pytest.approx(step)


@pytest.mark.parametrize(
    "degrees",
    [ANGLES, np.round(ANGLES, 4), np.round(ANGLES), 0.5 * np.round(2 * ANGLES), np.tile(ANGLES[:1], (30, 1)).round(2), ANGLES[:3].round(2)],
    ids=["measured", "0.0001°", "planned, whole", "planned, halves", "never moved", "too few"],
)
def test_fine_angles_planned_postures_and_too_few_are_not_taken_for_rounded(degrees):
    assert joint_step(np.radians(degrees)) == 0.0


@pytest.mark.parametrize(("decimals", "step_deg"), [(2, 0.01), (3, 0.001)])
def test_rounding_is_seen_in_a_foreign_set_and_counted_as_noise(tmp_path, decimals, step_deg):
    fine = scanner_cell(np.random.default_rng(2)).observations
    rounded = replace(fine, q=np.radians(np.round(np.degrees(fine.q), decimals)))
    write_observation_set(rounded, tmp_path / "set")
    read = load_observations(tmp_path / "set")
    assert read.cell.joint_step == pytest.approx(np.radians(step_deg))
    uniform = np.radians(step_deg) / 12**0.5
    before, now = first_noise(fine.cell), first_noise(read.cell)
    np.testing.assert_allclose(now.joint**2, before.joint**2 + uniform**2)
    np.testing.assert_allclose(np.exp(noise_prior(read.cell).centre[3:9]), now.joint)
    said = [w for w in calibrate(read).extra["warnings"] if "rounded" in w]
    assert len(said) == 1
    assert f"rounded to {step_deg:g}°" in said[0]
    assert "Precision to 6 at the ETHERNET object" in said[0]


def test_nothing_is_said_of_angles_with_all_their_digits(tmp_path):
    fine = scanner_cell(np.random.default_rng(2)).observations
    write_observation_set(fine, tmp_path / "set")
    read = load_observations(tmp_path / "set")
    assert read.cell.joint_step == 0.0
    assert not [w for w in calibrate(read).extra.get("warnings", ()) if "rounded" in w]
