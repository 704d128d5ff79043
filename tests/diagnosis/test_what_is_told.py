"""Rules between what was found and what is told: names beside a mismatch, a group that may be a name, what the data do not see."""

from types import SimpleNamespace

import made
import numpy as np
import pytest
from mbcacq.diagnosis.nonparametric.evidence_atlas import EvidenceMap

from mbcacq.diagnosis.nonparametric import model_comparison
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.result import EffectFound
from mbcacq.diagnosis.search.beam_search import BeamSearch
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.verdict import reportable


@pytest.fixture(scope="module")
def setup(plan):
    return prepare(plan)


def removing(share):
    return EffectFound("backlash", ("A2",), {}, 1e-4, share, depends_on="direction_2")


@pytest.mark.parametrize(("verdict", "least"), [("unexplained", 0.05), ("partly_explained", 0.005)])
def test_a_name_that_describes_next_to_nothing_of_a_mismatch_is_not_told(verdict, least):
    effects = [removing(share) for share in (0.9 * least, 1.1 * least, 0.5)]

    assert reportable(effects, verdict) == effects[1:]


def test_where_names_explain_all_a_small_one_is_told_too():
    effects = [removing(0.001), removing(0.9)]

    assert reportable(effects, "explained") == effects


def test_a_long_recording_counts_what_is_hardly_seen_like_the_rest(setup):
    shift = next(c for c in setup.candidates if c.name == "mount_shift")
    covariance = np.diag(shift.typical**2) * [1, 1, 1, 1e4, 1e4, 1e4]
    coefficients = 5 * np.sqrt(np.diag(covariance))

    short = BeamSearch(setup.candidates).strengths(shift, coefficients, covariance)
    long = BeamSearch(setup.candidates, thorough=False).strengths(shift, coefficients, covariance)

    assert long.gain == pytest.approx(short.gain)
    assert np.ptp(long.seen) == 0 < np.ptp(short.seen)
    assert long.test[1] == pytest.approx(6)
    assert short.test[1] < 4


def overshadowing(monkeypatch, at, depends_on, share):
    """A single group of the map, far more probable than an elastic joint 2 that removes this share of what the group removes."""
    group = SimpleNamespace(at=at, depends_on=depends_on, gain=1000.0, weighed=1000.0)
    monkeypatch.setattr(model_comparison, "EvidenceMap", lambda *_: SimpleNamespace(judge=lambda _: SimpleNamespace(best=lambda: group)))
    screen = SimpleNamespace(test=lambda *_: SimpleNamespace(gain=share * group.gain))
    elastic = SimpleNamespace(name="joint_compliance", where=("A2",), depends_on="gravity_torque_2", k=1)
    return model_comparison.overshadowed(screen, None, EffectSet(((elastic, None),), worth=share * group.gain))


def test_a_name_gives_way_to_a_group_that_is_plainly_more_probable(monkeypatch):
    assert overshadowing(monkeypatch, "A3", "q3", 0.8)
    assert overshadowing(monkeypatch, "A2", "gravity_torque_2", 0.3)


def test_a_large_effect_is_not_overshadowed_by_its_own_place(monkeypatch):
    """It is bent a little because it is large; the group at its joint, along its variable, follows the bend."""
    assert not overshadowing(monkeypatch, "A2", "gravity_torque_2", 0.8)


def test_a_column_that_these_data_do_not_see_is_nothing_and_no_fraction_of_it(plan):
    setup = prepare(made.observe(plan, 17, [("joint_compliance", ("A2",), [2e-5], None)]))
    screen = CandidateScoring.of(setup.linear, setup.prior_noise)
    cell = EvidenceMap(screen, setup.design_blocks).judge(screen).best()
    for layer in setup.design_blocks.layers:
        layer.functions[:] = 0.0

    assert np.all(EvidenceMap(screen, setup.design_blocks).group(cell).columns == 0.0)
