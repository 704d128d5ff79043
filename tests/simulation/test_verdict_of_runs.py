"""Runs of a model by the recorded set points decide the verdict, not the torque along the recorded motion."""

import pytest

from mbcacq.diagnosis.motion.result import FitOfMotion, MotionDiagnosis
from mbcacq.simulation.model_match import ChannelError, ModelCheck, ModelMatch, ModelParameter
from mbcacq.workflow.diagnosis_result import DiagnosisResult

MASS = ModelParameter(name="inertia", where="link6", parameter="mass_kg", before=5.0, after=10.99993, std=2.7e-4, p_value=0.0, named=True)
CENTRE = ModelParameter(
    name="inertia", where="link6", parameter="centre_y_mm", before=1.35024e-15, after=20.0014, std=0.0017, p_value=0.0, named=True
)


def error(before, after):
    return ChannelError("A1 tau", "N m", 0.4, before, after)


def match(errors, parameters=(), compared="runs", checks=()):
    return ModelMatch(model="arm.xml", xml="", parameters=tuple(parameters), compared=compared, errors=tuple(errors), checks=tuple(checks))


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (match([error(0.41, 0.41)]), "none"),
        (match([error(40.0, 0.41)], [MASS]), "explained"),
        (match([error(40.0, 2.0)], [MASS]), "partly_explained"),
        (match([error(2.0, 2.0)]), "unexplained"),
        (match([error(40.0, 0.41), error(2.0, 2.0)], [MASS]), "partly_explained"),
        (match([error(40.0, 0.41)], [MASS], checks=[ModelCheck("another", (error(40.0, 3.0),))]), "partly_explained"),
        (match([error(0.41, 0.41)], compared="torques"), None),
    ],
)
def test_what_the_runs_leave_is_the_verdict(found, verdict):
    assert found.verdict == verdict


def test_the_text_opens_with_the_runs_and_then_says_how_the_mismatch_was_located():
    found = match([error(0.41, 0.41)])
    motion = MotionDiagnosis(
        verdict=found.verdict,
        mismatch=(),
        effects=(),
        fit=FitOfMotion.of((), "trajectory"),
        suspicions=("with +6.68 kg the torque is explained better",),
    )
    text = DiagnosisResult(motion=motion, simulation=found).text
    order = [
        "No effect: the simulation",
        "Nothing is to be changed in arm.xml",
        "0.410 -> 0.410 N·m",
        "Along the recorded motion",
        "+6.68 kg",
    ]
    places = [text.index(part) for part in order]
    assert places == sorted(places)
    assert places[0] == 0


def test_values_are_printed_to_their_uncertainty_without_rounding_errors():
    text = match([error(40.0, 0.41)], [MASS, CENTRE]).text
    assert "5 -> 10.99993 ± 0.00054" in text
    assert "0 -> 20.0014 ± 0.0034" in text
