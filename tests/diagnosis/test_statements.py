"""The checker of statements finds what contradicts itself, and nothing in what does not."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from test_diagnosis_read_aloud import SOFT, UNMODELLED, diagnosed

from mbcacq.diagnosis.effect_found import Alternative, FoundAgain
from mbcacq.diagnosis.findings import NotSeparable
from mbcacq.diagnosis.result import FitSummary, HeldOutFigures
from mbcacq.effects.effect import ParameterEstimate

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from statements import contradictions

WEAK = replace(SOFT, held_out_gain=0.0)
ONCE = replace(SOFT, found_again=(FoundAgain("A2", 1, 2, True),))
NEVER = replace(SOFT, found_again=(FoundAgain("A2", 0, 4, False),))
BESIDE = replace(
    UNMODELLED,
    parameters={"A1(q1).rms_mm": ParameterEstimate(0.1, 0.01), "A2(q2).rms_mm": ParameterEstimate(0.2, 0.01)},
    alternatives=(Alternative("unknown", ("A1",), 0.0, 1e-9),),
)
WIDE = replace(SOFT, name="gear_transmission_error", where=("A6",), parameters={"A6.order": ParameterEstimate(1.0, 0.6)}, alternatives=())
ROBUST = HeldOutFigures(0.02, 0.009, 4.0, 1.0, "station", centres=419, robust_centres=440)
APART = (NotSeparable(("joint_compliance:A2", "lost_motion:A2"), 0.07, 1 / 15 / 5),)


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (diagnosed("none", SOFT), "the verdict is none beside effects"),
        (diagnosed("explained", WEAK), "explained without a finding"),
        (diagnosed("explained", SOFT, ONCE), "explained by what parts do not show again"),
        (diagnosed("explained", SOFT, UNMODELLED), "explained beside something unmodelled"),
        (diagnosed("unexplained", SOFT), "unexplained without anything unmodelled"),
        (diagnosed("cannot_tell", SOFT, not_separable=APART), "cannot be told apart at odds 0.013"),
        (diagnosed("unexplained", BESIDE), "unknown at A1 is stated and in the place of itself"),
        (diagnosed("cannot_tell", WEAK), "and each effect removes nothing"),
        (diagnosed("partly_explained", SOFT, chi2=(4.0, 6.0)), "chi2 of held-out data rises from 4.00 to 6.00"),
        (diagnosed("explained", WIDE), "A6.order is stated although its uncertainty is 0.6"),
        (diagnosed("partly_explained", NEVER), "and no part of the recording shows it"),
    ],
)
def test_each_kind_of_contradiction_is_found(found, said):
    each = contradictions(found)
    assert any(said in one for one in each)


def test_robust_figures_of_more_centres_than_there_are_are_found():
    found = diagnosed("explained", SOFT)
    wrong = replace(found, fit=FitSummary(found.fit.train, ROBUST, 0.009))
    assert any("more centres than there are" in one for one in contradictions(wrong))


def test_a_sound_diagnosis_contradicts_nothing():
    assert contradictions(diagnosed("explained", SOFT)) == []
    assert contradictions(diagnosed("partly_explained", SOFT, UNMODELLED)) == []
    assert contradictions(diagnosed("none", before=0.009, after=0.009, chi2=(1.0, 1.0))) == []
