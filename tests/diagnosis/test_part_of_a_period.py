"""Periodic errors that a recording shows in part: over a quarter of the period, or at few angles."""

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.model_fit import fit_model
from mbcacq.diagnosis.output.repetition import sentences
from mbcacq.diagnosis.problem import prepare
from mbcacq.estimation.forward_model import Displacements

AMPLITUDE, ORDER = 1.2e-3, 4.0


def wave_of_joint_five(context):
    joint = np.zeros(context.obs.q.shape)
    joint[:, 4] = AMPLITUDE * np.sin(ORDER * context.obs.q[:, 4] + 0.4)
    return Displacements(joint=joint)


@pytest.fixture(scope="module")
def postures():
    rng, limits = np.random.default_rng(3), simulated.robot().limits
    return np.clip(rng.uniform(0.5 * limits[:, 0], 0.5 * limits[:, 1], (60, 6)), -2.2, 2.2)


def test_a_quarter_of_a_period_is_no_gear_error_and_no_larger_than_the_misfit(postures):
    q = postures.copy()
    q[:, 4] = np.random.default_rng(4).uniform(0.35, 0.35 + 2 * np.pi / ORDER / 4, len(q))

    found = diagnose(simulated.observe(simulated.tracked(q), 8, [wave_of_joint_five]), folds=2)

    (effect,) = found.effects
    assert (effect.name, effect.where) == ("unknown", ("A5",))
    assert set(effect.parameters) == {"A5(q5).rms_mm"}
    assert effect.parameters["A5(q5).rms_mm"].value < found.fit.train.before_rms_mm


def test_orders_that_look_alike_at_the_angles_of_a_recording_are_all_named(postures):
    """A4 stands at multiples of 15 degrees only, at which orders 7, 17, 31, .. (24 k +- 7) are the same."""
    q = postures.copy()
    q[:, 3] = np.radians(15.0 * np.round(np.degrees(q[:, 3]) / 15.0))

    found = diagnose(simulated.observe(simulated.tracked(q), 9, [("gear_transmission_error", ("A4",), [3e-4, 2e-4], 7.0)]), folds=2)

    (effect,) = found.effects
    assert (effect.name, effect.where) == ("gear_transmission_error", ("A4",))
    assert "A4.order" not in effect.parameters
    assert [one.at for one in effect.orders] == ["A4"] * len(effect.orders)
    assert len(effect.orders) > 3
    assert not any(one.determined for one in effect.orders)
    for one in effect.orders:
        assert min((one.order - 7) % 24, (one.order + 7) % 24, (7 - one.order) % 24, (-7 - one.order) % 24) < 0.3
    rms = effect.parameters["A4.rms_deg"]
    assert abs(rms.value - np.degrees(np.hypot(3e-4, 2e-4)) / np.sqrt(2)) < 3 * rms.std
    assert any(line.startswith("A4: the order is not determined (between") for line in sentences(effect))


def test_order_and_amplitude_of_half_a_period_are_uncertain_together(postures):
    """Over half a turn an error of order one is nearly one of order two with another amplitude, and is found as such here."""
    q, amplitude = postures.copy(), 1.6e-4
    q[:, 3] = np.random.default_rng(13).uniform(-1.6, 1.6, len(q))
    phase = amplitude * np.array([np.cos(16.9), np.sin(16.9)])

    full = fit_model(prepare(simulated.observe(simulated.tracked(q), 13, [("gear_transmission_error", ("A4",), phase, 1.0)])))

    (member,) = full.model.members
    candidate, order = member.candidate, member.hyper
    found = candidate.parameters(full.model.coefficients, full.model.covariance, order)
    assert abs(found["A4.order"].value - 1.0) < 3 * found["A4.order"].std
    assert abs(found["A4.amplitude_deg"].value - np.degrees(amplitude)) < 3.5 * found["A4.amplitude_deg"].std
    assert found["A4.order"].std < 1.0
