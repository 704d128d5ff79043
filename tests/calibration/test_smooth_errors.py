"""What an arm does beyond its geometry is learnt by a calibration that knows nothing of it, and is right at places that took no part."""

from pathlib import Path

import pytest
from erring_arms import LAWS, erring_arm, placed_wrong

from mbcacq.calibration import CalibrationOptions, calibrate
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.design.adaptive.first_block import first_block
from mbcacq.plan import expand, load

GEOMETRY = CalibrationOptions(discrepancy=False)


def at_new_places(law, seed, options=None):
    learn, new, truth = erring_arm(LAWS[law], seed)
    found = calibrate(learn, options)
    return placed_wrong(found, new, truth), {t.depends_on + t.variant for t in found.effects.terms} if found.effects else set()


def test_an_arm_without_further_errors_is_calibrated_as_by_geometry_alone():
    off, groups = at_new_places("nothing further", 3)
    assert groups == set()
    assert off == at_new_places("nothing further", 3, GEOMETRY)[0]


def test_a_wind_up_goes_on_at_torques_beyond_those_that_were_there():
    """A2 carries 190 to 417 N m in the recording, and -436 to 434 N m at the new places."""
    clean = at_new_places("nothing further", 3)[0]
    assert at_new_places("elastic A2, A4", 3)[0] < 1.2 * clean
    assert at_new_places("elastic A2, A4", 3, GEOMETRY)[0] > 4.0 * clean


@pytest.mark.parametrize("law", ["gear errors of orders 2 to 4", "gear errors of orders 17 and 22"])
def test_wheels_of_a_gear_are_learnt_each_by_its_own_periods(law):
    off, groups = at_new_places(law, 0)
    assert off < 0.35 * at_new_places(law, 0, GEOMETRY)[0]
    if "17" in law:
        assert {"q2order 17", "q3order 22"} <= groups
        assert len(groups) <= 6


def test_few_poses_in_which_no_group_is_left_are_calibrated():
    """The 24 poses that show most of one cell: own errors shrink to nothing there, and so do all that are tried after them."""
    plan = first_block(load(Path(__file__).parents[2] / "plans" / "seeing.yaml"))
    coupled = [{"name": "wrist_coupling", "strength": 0.0431422939131256, "seed": 1479368136}]
    obs, _ = observe(plan, expand(plan), Scenario(16, "wrist_coupling", 521319236, ("wrist_coupling",), 1479368136, 0.354), coupled)
    assert obs.n_poses == 24
    fit = calibrate(obs).own_fit
    assert fit is not None
    assert fit.rms_mm < 0.03
