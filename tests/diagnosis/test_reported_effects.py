"""Rules between what was found and what is reported: small effects, a block that may be an effect, columns that vanish."""

import numpy as np
import pytest

from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.result import EffectFound
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.verdict import reportable


@pytest.fixture(scope="module")
def setup(plan):
    return prepare(plan)


def removing(share):
    return EffectFound("backlash", ("A2",), {}, 1e-4, share, depends_on="direction_2")


@pytest.mark.parametrize(("verdict", "least"), [("unexplained", 0.05), ("partly_explained", 0.005)])
def test_an_effect_that_explains_next_to_nothing_is_not_reported(verdict, least):
    effects = [removing(share) for share in (0.9 * least, 1.1 * least, 0.5)]

    assert reportable(effects, verdict) == effects[1:]


def test_where_effects_explain_all_a_small_one_is_reported_too():
    effects = [removing(0.001), removing(0.9)]

    assert reportable(effects, "explained") == effects


def test_a_long_recording_counts_all_directions_alike(setup):
    shift = next(c for c in setup.candidates if c.name == "mount_shift")
    covariance = np.diag(shift.typical**2) * [1, 1, 1, 1e4, 1e4, 1e4]
    coefficients = 5 * np.sqrt(np.diag(covariance))

    short = BeamSearch(setup.candidates).effect_prior(shift, coefficients, covariance)
    long = BeamSearch(setup.candidates, thorough=False).effect_prior(shift, coefficients, covariance)

    assert long.gain == pytest.approx(short.gain)
    assert np.ptp(long.information) == 0 < np.ptp(short.information)
    assert long.detection_statistic[1] == pytest.approx(6)
    assert short.detection_statistic[1] < 4
