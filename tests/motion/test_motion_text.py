"""What the diagnosis of motion says of a size that has no value, and of an effect without a model."""

import numpy as np
import pytest

from mbcacq.diagnosis.effect_found import EffectFound, ResponseShape
from mbcacq.diagnosis.findings import OUT_OF_TIME
from mbcacq.diagnosis.motion.result import ChannelFit, ErrorBeforeAfter, FitOfMotion, MotionDiagnosis
from mbcacq.diagnosis.motion.text import motion_text
from mbcacq.diagnosis.output.text import describe
from mbcacq.effects.effect import ParameterEstimate, number


def text_of(*effects):
    return motion_text(MotionDiagnosis(verdict="partly_explained", mismatch=(), effects=effects, fit=FitOfMotion.of((), "trajectory")))


@pytest.mark.parametrize(("std", "said"), [(125.3, "A2 phase is not determined"), (20.0, "A2 phase (−84 ± 40)°")])
def test_a_phase_that_may_be_anywhere_is_not_given_as_a_number(std, said):
    parameters = {"A2.order": number(829.2, 1.93), "A2.phase_deg": number(-83.65, std)}
    effect = EffectFound(
        name="gear_transmission_error",
        where=("A2",),
        depends_on="q2",
        channel="q_joint",
        parameters=parameters,
        p_value=1e-9,
        held_out_gain=0.1,
        held_out_gain_here=0.1,
        alternatives=(),
        steps=(),
    )
    text = text_of(effect)
    assert said in text
    assert "A2 order 829.2 ± 3.9" in text


def friction(at, value, std):
    return EffectFound(
        name="friction",
        where=(at,),
        depends_on="qd2",
        channel="tau",
        parameters={f"{at}.coulomb_Nm": ParameterEstimate((value, -value), (std, std))},
        p_value=1e-9,
        held_out_gain=0.1,
        held_out_gain_here=0.1,
        alternatives=(),
        steps=(),
    )


def test_a_size_within_its_uncertainty_is_a_trend_without_a_figure():
    """1.9 standard deviations of A2 stand before 2.1 of A4, and behind them in the text."""
    text = text_of(friction("A2", 1.9, 1.0), friction("A4", 2.1, 1.0))
    findings, trends = text.split("Trends, without a reliable figure:")
    assert "friction at A4" in findings
    assert "coulomb 2.1 ± 2.0" in findings
    assert "friction at A2" in trends
    assert "coulomb" not in trends


def test_the_same_of_poses():
    parameters = {"A2.phase_deg": ParameterEstimate((10.0, 20.0), (120.0, 200.0)), "A2.amplitude_deg": ParameterEstimate(0.01, 0.001)}
    lines = describe(EffectFound(name="gear_transmission_error", where=("A2",), parameters=parameters, p_value=1e-9, held_out_gain=0.1))
    assert "  A2 phase is not determined" in lines
    assert "  A2 amplitude (0.0100 ± 0.0020)°" in lines


def test_time_that_ran_out_is_no_fault_of_the_data():
    found = MotionDiagnosis(
        verdict="cannot_tell", mismatch=(), effects=(), fit=FitOfMotion.of((), "trajectory"), suspicions=(OUT_OF_TIME, "a sign is wrong")
    )
    text = motion_text(found)
    assert text.startswith("Cannot tell: time ran out before all explanations were compared.")
    assert "The description of the data looks wrong: time" not in text
    assert "The description of the data looks wrong: a sign is wrong" in text


def test_a_degree_sign_stands_at_its_number():
    error = ErrorBeforeAfter(0.0356, 0.00384, 9.0, 1.0)
    one = ChannelFit(channel="q_joint", at="A1", unit="deg", noise_floor=0.003, train=error, held_out=error)
    found = MotionDiagnosis(verdict="explained", mismatch=(), effects=(), fit=FitOfMotion.of((one,), "trajectory"))
    assert "0.0356° before, 0.00384 after" in motion_text(found)


def unmodelled(channel, y):
    shape = ResponseShape((0.0, 1.0), y)
    found = {"parameters": {}, "p_value": 1e-9, "held_out_gain": 0.1, "shape": shape}
    return EffectFound(name="unknown", where=("A2",), depends_on="q2", channel=channel, **found)


def test_an_unmodelled_effect_has_a_size():
    y = (3.0, -4.0)
    assert "rms 3.54 N·m, as a function of q2" in text_of(unmodelled("tau", y))
    angle = tuple(np.radians(y).tolist())
    assert "rms 3.54°, as a function of q2" in text_of(unmodelled("q_set", angle))
