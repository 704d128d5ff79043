"""How far above the noise a model stays, and what is a trend and no figure."""

from dataclasses import replace

import numpy as np
import pytest

from mbcacq.diagnosis.effect_found import EffectFound, trend
from mbcacq.diagnosis.output.noise_floor import NoiseFloor
from mbcacq.diagnosis.output.text import limit_lines, summary_lines, words
from mbcacq.diagnosis.result import Diagnosis, ExclusionBand, ExclusionLimit
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.model.json_text import from_fields


def test_the_uncertainty_of_an_rms_is_that_of_the_chi_square_distribution():
    """Twice the scatter of the rms of so many centres of normal noise, drawn."""
    rng = np.random.default_rng(4)
    rms = np.sqrt(np.mean(np.sum(rng.normal(size=(4000, 200, 3)) ** 2, axis=2), axis=1))
    floor = NoiseFloor.of(0.0, 1.0, 200)
    assert floor.expanded_mm == pytest.approx(2 * rms.std() / rms.mean(), rel=0.05)


def test_a_model_within_the_uncertainty_of_the_noise_reaches_it():
    assert NoiseFloor.of(0.0133, 0.0129, 512).distance == "down to the measured noise"
    assert NoiseFloor.of(0.0145, 0.0129, 512).distance == "to 1.60 ± 0.47 µm (k = 2; 12%) above the measured noise"
    assert NoiseFloor.of(0.0145, 0.0129, 512).noise == "12.90 ± 0.47 µm"
    assert NoiseFloor.of(0.0145, 0.0129, 0).noise == "12.9 µm"


@pytest.mark.parametrize(
    ("parameters", "weak"),
    [
        ({"offset_mm": ((0.018, -0.006, 0.023), (0.050, 0.014, 0.052)), "time_constant_s": ((356.0,), (12.0,))}, True),
        ({"offset_mm": ((0.018, -0.06, 0.023), (0.050, 0.014, 0.052))}, False),  # one component is beyond its uncertainty
        ({"A2.order": ((2.0,), (0.02,)), "A2.amplitude_deg": ((0.01,), (0.02,))}, True),  # a known order is no size
        ({}, False),
        ({"shift_mm": ((None,), (None,))}, False),
    ],
)
def test_an_effect_below_its_expanded_uncertainty_is_a_trend(parameters, weak):
    assert ("uncertainty" in trend(parameters, 0.3)) is weak


@pytest.mark.parametrize(("gain", "nothing"), [(0.0, True), (0.0004, True), (0.0006, False), (1.0, False), (None, False), (np.nan, False)])
def test_an_effect_that_removes_nothing_of_held_out_data_is_a_trend_however_sure_its_size_is(gain, nothing):
    drift = {"name": "station_drift", "where": ["station3"], "parameters": {"drift_mm": {"value": [1.17], "std": [0.07]}}, "p_value": 1e-70}
    found = EffectFound(
        name="station_drift", where=("station3",), parameters={"drift_mm": ParameterEstimate(1.17, 0.07)}, p_value=1e-70, held_out_gain=gain
    )
    assert ("as well without it" in found.trend) is nothing
    assert from_fields(EffectFound, {**drift, "held_out_gain": gain}).trend == found.trend  # of an earlier version, which does not say it


def test_what_an_effect_removes_has_the_uncertainty_of_the_noise_that_it_is_seen_in():
    """Two predictions of the same data, drawn 2000 times: the share that one removes scatters by what is said of it."""
    rng = np.random.default_rng(5)
    truth, small = 3.0 * rng.normal(size=600), 0.2 * rng.normal(size=600)
    shares, stds = [], []
    for _ in range(2000):
        data = truth + small + rng.normal(size=600)
        before, without, after = (PredictiveScore(0.0, 0, float(np.sum((data - p) ** 2)), 600) for p in (0.0 * truth, truth, truth + small))
        validation = CrossValidation(before, after, "station", {"small": without})
        shares.append((without.chi2 - after.chi2) / (before.chi2 - before.dof))
        stds.append(validation.gain_std(max(shares[-1], 0.0)))
    assert np.std(shares) == pytest.approx(np.median(stds), rel=0.1)


@pytest.fixture
def diagnosed():
    """A diagnosis with a model that a calibration takes."""
    before_and_after = {"before_rms_mm": 0.05, "after_rms_mm": 0.013, "before_chi2_dof": 7.0, "after_chi2_dof": 1.0}
    fit = {"train": before_and_after, "held_out": {**before_and_after, "split": "station"}, "repeatability_floor_mm": 0.0129}
    found = Diagnosis.from_json({"format": "mbcacq-diagnosis/3", "verdict": "explained", "mismatch": [], "effects": [], "fit": fit})
    return replace(found, model=("some terms",))


def effect(name, where, **parameters):
    return EffectFound(name=name, where=(where,), parameters=parameters, p_value=1e-9, held_out_gain=0.1)


def test_a_trend_is_no_finding(diagnosed):
    """A trend stands behind the findings, and without a figure."""
    strong = effect("joint_compliance", "A2", compliance_rad_per_Nm=ParameterEstimate(2e-6, 1e-7))
    weak = effect("scanner_warmup", "scanner", offset_mm=ParameterEstimate(0.018, 0.025))
    both = replace(diagnosed, effects=(weak, strong))
    lines = summary_lines(both, NoiseFloor(0.013, 0.0129))
    assert lines[0] == "What and where: joint_compliance at A2"
    assert lines[1] == "Trend, too weak for a figure: scanner_warmup at scanner"
    text = words(both)
    assert (
        text.index("joint_compliance at A2 (p")
        < text.index("Trends, without a reliable figure:")
        < text.index("scanner_warmup at scanner (p")
    )
    assert "offset" not in text
    alone = summary_lines(replace(diagnosed, effects=(weak,)), NoiseFloor(0.013, 0.0129))
    assert alone[0] == "What and where: no effect with a reliable figure"


def test_what_was_done_just_now_is_no_next_step(diagnosed):
    assert "--calibrate" in words(diagnosed)
    assert "--calibrate" not in words(diagnosed, calibrated=True)
    assert "What next: verify the calibration with what was found on another recording" in words(diagnosed, calibrated=True)


def test_what_is_beyond_what_machines_have_was_not_tested():
    absurd = ExclusionLimit(
        name="mount_compliance",
        where=("mount",),
        parameter="compliance_mm_per_N",
        value=0.35,
        workspace_mm=None,
        length_mm=None,
        in_usual_sizes=350.0,
        tested=False,
    )
    absorbed = ExclusionLimit(
        name="base_compliance",
        where=("base",),
        parameter="compliance_rad_per_Nm",
        value=None,
        workspace_mm=None,
        length_mm=None,
        in_usual_sizes=None,
        tested=False,
    )
    step = ExclusionLimit(
        name="joint_step",
        where=("A6",),
        parameter="A6.step_deg",
        value=0.0078,
        workspace_mm=0.22,
        length_mm=0.19,
        in_usual_sizes=1.4,
        holds_for=ExclusionBand("at_pose", 3, 118, (17, 33)),
    )
    slow = ExclusionLimit(
        name="gear_transmission_error",
        where=("A2",),
        parameter="A2.amplitude_deg",
        value=0.004,
        workspace_mm=None,
        length_mm=None,
        holds_for=ExclusionBand("order", 1.0, 1.5),
    )
    once = replace(step, holds_for=ExclusionBand("at_pose", 3, 118, (17,)))
    assert "(but 1 that these poses hide) up to" in limit_lines([once])[0]
    lines = limit_lines([step, slow, absurd, absorbed])
    assert lines == [
        "Not excluded (95 %): joint_step at A6, beginning at any pose from 3 to 118 (but 2 that these poses hide) up to step 0.0078° "
        "(1.4 times the usual size), 0.22 mm in the workspace, 0.19 mm in a length",
        "Not excluded (95 %): gear_transmission_error at A2 of any order from 1.0 to 1.5 up to amplitude 0.0040°",
        "Not tested by these poses (only an effect of more than 10 times the usual size would show): mount_compliance at mount (compliance); "
        "base_compliance at base (compliance)",
    ]
