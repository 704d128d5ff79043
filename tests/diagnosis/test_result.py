"""The diagnosis as typed data: to JSON and back, through pickle, and in a notebook."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from mbcacq.diagnosis.effect_found import Alternative, EffectFound, MismatchEntry
from mbcacq.diagnosis.findings import Advice, NotSeparable
from mbcacq.diagnosis.output.pictures import pictures
from mbcacq.diagnosis.result import Diagnosis, ExclusionBand, ExclusionLimit, FitFigures, FitSummary, HeldOutFigures, NoiseDependence
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.errors import ConfigError

FOUND = Diagnosis(
    verdict="explained",
    mismatch=(MismatchEntry("A2", "gravity_torque_2", 0.71, 1e-12),),
    effects=(
        EffectFound(
            name="gear_transmission_error",
            where=("A2", "A3"),
            parameters={"A2.order": ParameterEstimate((1.0, 100.0), (0.01, 0.02)), "A3.order": ParameterEstimate(2.0, 0.01)},
            p_value=1e-12,
            held_out_gain=0.83,
            alternatives=(Alternative("joint_scale", ("A2",), 0.12, 0.003),),
            depends_on="q2",
        ),
    ),
    fit=FitSummary(FitFigures(0.061, 0.013, 19.0, 1.02), HeldOutFigures(0.064, 0.014, 20.1, 1.1, "station"), 0.012),
    not_separable=(NotSeparable(("thermal_growth:link2", "joint_scale:A1"), 0.98),),
    advice=(Advice("look elsewhere", ((0.0, -90.0, 90.0, 0.0, 10.0, 0.0),)),),
    dropped={"payload": "no masses"},
    notes=("a note",),
    exclusion_limits=(
        ExclusionLimit(name="joint_scale", where=("A6",), parameter="A6.ratio", value=2e-4, workspace_mm=0.05, length_mm=0.03),
        ExclusionLimit(
            name="joint_step",
            where=("A6",),
            parameter="A6.step_deg",
            value=0.01,
            workspace_mm=None,
            length_mm=None,
            in_usual_sizes=12.0,
            tested=False,
            holds_for=ExclusionBand("at_pose", 3.0, 90.0, (17.0,)),
        ),
        ExclusionLimit(name="station_drift", where=("stationp1",), parameter="shift_mm", value=None, workspace_mm=None, length_mm=None),
    ),
    noise_depends_on=(
        NoiseDependence(
            of="instrument", covariate="reach", unit="mm", low=500.0, high=900.0, sigma_low_mm=0.005, sigma_high_mm=0.015, p_value=1e-9
        ),
    ),
)


@pytest.fixture(scope="module")
def diagnosis(elastic_arm):
    return elastic_arm


def test_a_diagnosis_goes_to_json_and_back():
    text = json.dumps(FOUND.to_json(), allow_nan=False)

    assert Diagnosis.from_json(json.loads(text)) == FOUND
    assert json.dumps(Diagnosis.from_json(json.loads(text)).to_json()) == text


def test_the_keys_are_those_of_the_format():
    content = FOUND.to_json()

    keys = "format verdict mismatch effects fit geometry_alone not_separable advice dropped notes exclusion_limits between_recordings"
    assert set(content) == {*keys.split(), "proposals", "noise_depends_on", "model", "evidence"}
    keys = "name where parameters p_value held_out_gain alternatives depends_on p_local p_corrected log_bayes_factor equivalent"
    assert set(content["effects"][0]) == {*keys.split(), "held_out_gain_std", "trend"}
    assert set(content["fit"]["held_out"]) == {"before_rms_mm", "after_rms_mm", "before_chi2_dof", "after_chi2_dof", "split"}
    assert content["effects"][0]["parameters"]["A2.order"] == {"value": [1.0, 100.0], "std": [0.01, 0.02]}


def test_what_is_not_finite_is_null_in_json_and_not_a_number_again():
    content = replace(FOUND, mismatch=(MismatchEntry("A2", "q2", np.inf, 0.5),)).to_json()

    assert content["mismatch"][0]["share"] is None
    assert np.isnan(Diagnosis.from_json(content).mismatch[0].share)


@pytest.mark.parametrize("content", [{}, {"format": "mbcacq-result/1"}, {"format": "mbcacq-diagnosis/1", "fit": {}}])
def test_an_object_of_another_kind_is_refused(content):
    with pytest.raises(ConfigError, match="diagnosis"):
        Diagnosis.from_json(content)


def test_a_diagnosis_shows_itself_in_a_notebook():
    hostile = replace(FOUND, effects=(replace(FOUND.effects[0], where=("<b>",)),))

    assert repr(FOUND).startswith("<Diagnosis explained: gear_transmission_error at A2, A3; held out: 64.0 µm before, 14.0 µm after")
    assert "A2 order 1.000 ± 0.020, 100.000 ± 0.040" in FOUND._repr_html_()
    assert "<td>&lt;b&gt;</td>" in hostile._repr_html_()
    assert "http" not in FOUND._repr_html_()


def test_a_diagnosis_pickles_with_what_its_pictures_need(diagnosis):
    again = pickle.loads(pickle.dumps(diagnosis))

    assert again == diagnosis
    assert pictures(again) == pictures(diagnosis)


def test_a_diagnosis_that_was_read_from_json_has_no_pictures(diagnosis):
    with pytest.raises(ConfigError, match="diagnose the recording again"):
        pictures(Diagnosis.from_json(diagnosis.to_json()))
