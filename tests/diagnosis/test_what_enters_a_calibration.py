"""Nothing enters a calibration that does not predict held-out data better than without it."""

from types import SimpleNamespace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.output.kept_model import predicting_better, term_of
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.validation.cross_validation import CrossValidation
from mbcacq.diagnosis.validation.predictive_score import PredictiveScore
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel

FITTED = SimpleNamespace(everywhere=False)


def score(square: float, chi2: float) -> PredictiveScore:
    return PredictiveScore(square, 100, chi2, 300.0)


@pytest.fixture(scope="module")
def found():
    """Three effects as terms: an elastic joint, a base that gives way, a drift of a station."""
    plan = simulated.plan(6, 3)
    here, terms = Covariates(plan), []
    for label in ("joint_compliance:A2", "base_compliance:base", "station_drift:station2"):
        candidate = next(c for c in prepare(plan).candidates if c.label == label)
        hyper = None if candidate.hyper is None else float(candidate.hyper.values[0])
        terms.append(term_of(here, candidate, hyper, candidate.typical, candidate.typical))
    return EffectModel(plan.cell.robot, tuple(terms))


def kept(found, split, without, before=None, refitted=None):
    validation = CrossValidation(before or score(9.0, 2000.0), score(1.0, 300.0), split, without, refitted=refitted or {})
    model, said = predicting_better(found, FITTED, validation)
    return [t.name for t in model.terms], said


def test_an_effect_that_helps_stays_and_one_that_does_not_is_named(found):
    without = {"joint_compliance": score(4.0, 900.0), "base_compliance": score(0.9, 310.0), "station_drift": score(1.0, 300.0)}
    names, said = kept(found, "block", without)
    assert names == ["joint_compliance"]
    assert len(said) == 2
    assert said[0].startswith("base_compliance at base is not kept")


def test_an_effect_that_only_makes_the_prediction_less_certain_does_not_stay(found):
    names, _ = kept(found, "block", {"joint_compliance": score(4.0, 900.0), "base_compliance": score(0.8, 400.0)})
    assert names == ["joint_compliance", "station_drift"]


def test_what_a_station_does_alone_is_not_judged_by_other_stations(found):
    without = {"joint_compliance": score(4.0, 900.0), "base_compliance": score(2.0, 400.0), "station_drift": score(1.0, 300.0)}
    assert kept(found, "station", without) == (["joint_compliance", "base_compliance", "station_drift"], [])


def test_an_effect_that_no_part_finds_again_is_judged_with_its_own_coefficients(found):
    same = {name: score(1.0, 300.0) for name in ("base_compliance", "station_drift")} | {"joint_compliance": score(4.0, 900.0)}
    refitted = {"base_compliance": (score(0.8, 290.0), score(1.0, 320.0)), "station_drift": (score(0.8, 290.0), score(0.7, 280.0))}
    names, said = kept(found, "block", same, refitted=refitted)
    assert names == ["joint_compliance", "base_compliance"]
    assert [sentence.split(" at ")[0] for sentence in said] == ["station_drift"]


def test_effects_that_stand_for_each_other_stay_where_both_together_help(found):
    same = {name: score(1.0, 300.0) for name in ("joint_compliance", "base_compliance", "station_drift")}
    names, said = kept(found, "block", same)
    assert (names, said) == (["joint_compliance", "base_compliance", "station_drift"], [])
    names, said = kept(found, "block", same, before=score(1.0, 300.0))
    assert names == []
    assert np.size(said) == 3
