"""How far above the noise a model stays, and what is a trend and no figure."""

import numpy as np
import pytest

from mbcacq.diagnosis.output.noise_floor import NoiseFloor, is_trend
from mbcacq.diagnosis.output.text import limit_lines
from mbcacq.diagnosis.result import ExclusionLimit


def test_the_uncertainty_of_an_rms_is_that_of_the_chi_square_distribution():
    """Twice the scatter of the rms of so many centres of normal noise, drawn."""
    rng = np.random.default_rng(4)
    rms = np.sqrt(np.mean(np.sum(rng.normal(size=(4000, 200, 3)) ** 2, axis=2), axis=1))
    floor = NoiseFloor.of(0.0, 1.0, 200)
    assert floor.expanded_mm == pytest.approx(2 * rms.std() / rms.mean(), rel=0.05)


def test_a_model_within_the_uncertainty_of_the_noise_reaches_it():
    assert NoiseFloor.of(0.0133, 0.0129, 512).distance == "down to the measured noise"
    assert NoiseFloor.of(0.0145, 0.0129, 512).distance == "to 1.6 µm (12%) above the measured noise"
    assert NoiseFloor.of(0.0145, 0.0129, 512).noise == "(12.9 ± 0.5) µm"
    assert NoiseFloor.of(0.0145, 0.0129, 0).noise == "12.9 µm"


@pytest.mark.parametrize(
    ("parameters", "trend"),
    [
        ({"offset_mm": ((0.018, -0.006, 0.023), (0.050, 0.014, 0.052)), "time_constant_s": ((356.0,), (12.0,))}, True),
        ({"offset_mm": ((0.018, -0.06, 0.023), (0.050, 0.014, 0.052))}, False),  # one component is beyond its uncertainty
        ({"A2.order": ((2.0,), (0.02,)), "A2.amplitude_deg": ((0.01,), (0.02,))}, True),  # a known order is no size
        ({}, False),
        ({"shift_mm": ((None,), (None,))}, False),
    ],
)
def test_an_effect_below_its_expanded_uncertainty_is_a_trend(parameters, trend):
    assert is_trend(parameters) is trend


def test_a_limit_beyond_a_hundred_usual_sizes_was_not_tested():
    absurd = ExclusionLimit("mount_compliance", ("mount",), "compliance_mm_per_N", 0.35, 7.9, 0.0089, 3500.0)
    real = ExclusionLimit("joint_step", ("A6",), "A6.step_deg", 0.0078, 0.22, 0.19, 1.4)
    lines = limit_lines([absurd, real])
    assert lines == [
        "Not excluded (95 %): joint_step at A6 up to step 0.0078° (1.4 times the usual size), 0.22 mm in the workspace, 0.19 mm in a length",
        "Not tested by these poses (only what is over 100 times the usual size would show): mount_compliance at mount (compliance)",
    ]
