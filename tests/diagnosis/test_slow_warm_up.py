"""Only the rate of a scanner that warms up more slowly than the recording lasts is determined; what is stated of it says so."""

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.problem import prepare


def measured(plan, seed, offset_mm, time_constant_s):
    """Distances of the reported offset (3,) and time constant from the true ones in their standard deviations, and that of the latter."""
    observed = simulated.observe(plan, seed, [("scanner_warmup", ("scanner",), offset_mm, time_constant_s)])
    model = model_fit.fit_model(prepare(observed)).model
    (found,) = model.members
    assert found.candidate.name == "scanner_warmup"
    offset, constant = found.candidate.parameters(model.coefficients, model.covariance, found.hyper).values()
    away = (np.array(offset.value) - offset_mm) / np.array(offset.std)
    return away, (constant.value - time_constant_s) / constant.std, constant.std


@pytest.mark.parametrize(("seed", "lengths"), [(503, 3.0), (505, 1.0)])
def test_a_slow_warm_up_is_stated_as_uncertain_as_it_is(large_plan, seed, lengths):
    duration = np.ptp(large_plan.time_s)
    offset, constant, std = measured(large_plan, seed, [0.03 * lengths, 0.0, 0.06 * lengths], lengths * duration)
    assert np.abs(offset).max() < 3
    assert abs(constant) < 3
    assert std > 0.5 * duration


def test_a_warm_up_that_ends_within_the_recording_is_measured(large_plan):
    duration = np.ptp(large_plan.time_s)
    offset, constant, std = measured(large_plan, 502, [0.02, 0.0, 0.06], 0.2 * duration)
    assert np.abs(offset).max() < 3
    assert abs(constant) < 3
    assert std < 0.05 * duration


@pytest.mark.parametrize("seed", [704, 708, 710])
def test_a_weak_and_slow_warm_up_is_not_taken_for_a_small_fast_one(large_plan, seed):
    """The recording shows a change of some micrometres at its beginning: it may fade soon, or be the start of a larger one."""
    offset, constant, _ = measured(large_plan, seed, [0.027, -0.018, 0.036], 2.7 * np.ptp(large_plan.time_s))
    assert np.abs(offset).max() < 3
    assert abs(constant) < 3
