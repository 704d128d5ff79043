"""The shares of the mismatch add up to 100 %, or a sentence says why not."""

from types import SimpleNamespace

import pytest

from mbcacq.diagnosis.effect_found import MismatchEntry
from mbcacq.diagnosis.output.effects_table import mismatch_table
from mbcacq.diagnosis.output.notes import sum_of_shares
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore


@pytest.mark.parametrize(
    ("shares", "left", "said"),
    [
        ([0.6, 0.4], 100.0, []),
        ([0.3, 0.05], 160.0, ["the shares add up to 35%: several locations explain another 59% alike, 6% is not explained"]),
        ([0.7, 0.6], 150.0, ["the shares add up to 130%: together they explain 95%, because some compensate others, 5% is not explained"]),
        ([0.5], 1100.0, ["the shares add up to 50%: none is confirmed, 100% is not explained"]),
        ([], 1100.0, []),
    ],
)
def test_what_the_shares_add_up_to_is_said(shares, left, said):
    """An excess of 1000 over 100 degrees of freedom, of which a model leaves some."""
    before, after = (PredictiveScore(1.0, 50, chi2, 100.0) for chi2 in (1100.0, left))
    mismatch = [MismatchEntry(f"A{k + 1}", f"q{k + 1}", share, 1e-9) for k, share in enumerate(shares)]
    assert sum_of_shares(mismatch, before, after) == said


def test_what_two_effects_at_one_joint_explain_alike_is_in_the_share_of_the_joint():
    """Alone they explain 940 and 50 of an excess of 1000, and what both could explain is at this joint too."""
    candidate = SimpleNamespace(where=("A5",), depends_on="q5", k=2)
    cell = SimpleNamespace(location="A5", depends_on="q5", log_bayes_factor=30.0)
    model = SimpleNamespace(members=[SimpleNamespace(candidate=candidate)], gain=0.0)
    full = SimpleNamespace(model=model, cells=[cell], everywhere=False)
    explained = {(0,): 940.0, (1,): 50.0, (0, 1): 1000.0}
    contributions = SimpleNamespace(of=lambda which: explained[tuple(which)], groups_at=lambda *_: [1])
    before, after = (PredictiveScore(1.0, 50, chi2, 100.0) for chi2 in (1100.0, 100.0))
    (entry,) = mismatch_table(full, contributions, before)
    assert entry.share == pytest.approx(1.0)
    assert sum_of_shares([entry], before, after) == []
