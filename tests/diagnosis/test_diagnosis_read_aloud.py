"""The text of a diagnosis says nothing that has to be explained away."""

from dataclasses import replace

from mbcacq.diagnosis.effect_found import Alternative, EffectFound
from mbcacq.diagnosis.findings import OUT_OF_TIME, NotSeparable
from mbcacq.diagnosis.output.text import is_to_be_calibrated_with, words
from mbcacq.diagnosis.result import Diagnosis, EstimatedNoise, ExclusionLimit, FitFigures, FitSummary, GeometryAlone, HeldOutFigures
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.estimation.several_recordings import BetweenRecordings

NOISE = EstimatedNoise(scanner_mm=(0.003, 0.003, 0.005), joint_rad=(5e-6,) * 6)
GEOMETRY = GeometryAlone(
    poses=120, centres=600, rms_mm=0.02, chi2=1.0, dof=1, noise=NOISE, calibrated={}, T_flange_scanner=(), parameters=()
)


def diagnosed(verdict, *effects, before=0.020, after=0.009, chi2=(4.0, 1.0), **fields):
    held = HeldOutFigures(before, after, *chi2, "station")
    fit = FitSummary(FitFigures(before, after, *chi2), held, 0.009)
    return Diagnosis(verdict=verdict, mismatch=(), effects=effects, fit=fit, geometry_alone=(GEOMETRY,), **fields)


SOFT = EffectFound(
    name="joint_compliance",
    where=("A2",),
    parameters={"A2.compliance_rad_per_Nm": ParameterEstimate(2e-6, 1e-7)},
    p_value=1e-12,
    held_out_gain=0.9,
    alternatives=(Alternative("lost_motion", ("A2",), 0.0, 0.2), Alternative("payload", ("mount",), 0.0, 1e-5)),
)
UNMODELLED = replace(SOFT, name="unknown", where=("link2",), depends_on="q2", alternatives=(), parameters={})


def test_what_is_excluded_could_not_be_it():
    text = words(diagnosed("explained", SOFT))
    assert "could also be: lost_motion at A2 (odds 1 : 5" in text
    assert "excluded in its place: payload at mount (odds less than 1 : 1000)" in text


def test_where_nothing_was_found_there_is_no_before_and_after():
    text = words(diagnosed("none", before=0.009, after=0.009))
    assert "before" not in text
    assert "How much: 9.0 µm, on held-out data" in text


def test_of_a_misfit_within_the_uncertainty_of_the_noise_no_share_is_stated():
    assert "100% of the misfit beyond noise" in words(diagnosed("explained", SOFT))
    within = words(diagnosed("explained", SOFT, before=0.0092, after=0.0091, chi2=(1.02, 1.0)))
    assert "of the misfit beyond noise" not in within
    assert "of the excess over noise" not in within


def test_one_effect_removes_the_share_that_is_explained():
    """Few poses leave the fit uncertain, which millimetres show and chi2 allows for: shares of both would differ."""
    text = words(diagnosed("explained", replace(SOFT, held_out_gain=0.5), before=0.0162, after=0.0158, chi2=(1.2, 1.1)))
    assert "How much: 50% of the misfit beyond noise (χ²/dof 1.20 before, 1.10 after); 16.2 µm before, 15.8 µm after" in text
    assert "removes 50% of the excess over noise" in text
    assert "χ²/dof 109000 before" in words(diagnosed("explained", SOFT, chi2=(109003.21, 1.04)))


def test_what_few_poses_leave_uncertain_is_not_said_to_be_above_the_noise():
    text = words(diagnosed("none", before=0.0946, after=0.0946, chi2=(0.97, 0.97)))
    assert text.startswith("No effect: the simulation explains the recording down to the measured noise and the uncertainty of the fit.")
    assert "noise alone leaves 9.00 ± 0.30 µm (k = 2), and an uncertain fit the rest" in text
    assert "What next: measure more poses: what these determine predicts others to 94.6 µm only" in text
    assert "85.60 ± 0.30 µm (k = 2; 951%) above the measured noise" in words(
        diagnosed("none", before=0.0946, after=0.0946, chi2=(9.0, 9.0))
    )


def test_a_trend_that_does_not_help_states_no_share_and_is_not_to_be_calibrated_with():
    trend = replace(SOFT, held_out_gain=0.27, held_out_gain_std=0.3)
    found = diagnosed("cannot_tell", trend, model=("some terms",))
    assert not is_to_be_calibrated_with(found)
    assert is_to_be_calibrated_with(diagnosed("explained", SOFT, model=("some terms",)))
    text = words(found)
    assert text.startswith("A trend alone")
    assert "held-out data are predicted as well without it" in text
    assert "removes" not in text
    assert "What next: measure more poses: what was found is too weak to predict held-out data" in text


def test_where_all_that_was_found_is_a_trend_the_verdict_claims_no_figure():
    trend = replace(SOFT, parameters={"A2.compliance_rad_per_Nm": ParameterEstimate(1e-7, 1e-7)})
    text = words(diagnosed("explained", trend, before=0.0094, after=0.0094))
    assert text.startswith("A trend alone: the evidence shows an effect, and it is too weak for a figure.")
    assert words(diagnosed("explained", SOFT, trend)).startswith("Explained: the effects below bring the simulation")


def test_an_unmodelled_effect_says_what_it_is_a_function_of():
    assert "What and where: unmodelled effect of q2 at link2" in words(diagnosed("unexplained", UNMODELLED))


def test_a_verdict_that_cannot_tell_says_of_what():
    two = (NotSeparable(("joint_compliance:A2", "lost_motion:A2"), 0.99, 0.2),)
    text = words(diagnosed("cannot_tell", SOFT, not_separable=two))
    assert text.startswith("Cannot tell: these poses do not separate")
    assert "How sure: joint_compliance at A2 and lost_motion at A2 cannot be told apart (correlation 0.99, odds 1 : 5" in text
    assert "What next: measure more" in text
    assert words(diagnosed("cannot_tell", before=0.009)).startswith("Cannot tell: these poses leave open whether there is an effect")
    trend = replace(SOFT, parameters={"A2.compliance_rad_per_Nm": ParameterEstimate(1e-7, 1e-7)})
    text = words(diagnosed("cannot_tell", trend, UNMODELLED))
    assert text.startswith("Cannot tell: not all of what would explain the mismatch has a reliable figure in these poses.")
    assert "How sure: p < 10⁻⁶ for unmodelled effect of q2 at link2" in text


def test_of_several_effects_that_stand_together_each_is_in_words():
    two = (NotSeparable(("payload:mount", "payload:mount and unknown:link2"), 0.98, 0.3),)
    text = words(diagnosed("cannot_tell", SOFT, not_separable=two))
    assert "Cannot be told apart: payload at mount alone and together with unmodelled effect at link2 (correlation" in text
    assert "unknown" not in text
    other = (NotSeparable(("payload:mount", "backlash:A1 and unknown:link2"), 0.98, 0.3),)
    text = words(diagnosed("cannot_tell", SOFT, not_separable=other))
    assert "payload at mount and backlash at A1 together with unmodelled effect at link2 cannot be told apart" in text


def test_a_search_that_was_cut_short_blames_the_time_and_not_the_poses():
    text = words(diagnosed("cannot_tell", SOFT, notes=(OUT_OF_TIME,), model=("some terms",)))
    assert text.startswith("Cannot tell: time ran out before all explanations were compared.")
    assert "What next: give the diagnosis more time (--minutes)" in text


def test_what_differs_between_recordings_is_to_be_understood_first():
    two = BetweenRecordings(
        name="joint_compliance",
        where=("A2",),
        parameter="A2.compliance_rad_per_Nm",
        values=(3e-6, 2.4e-6),
        stds=(2e-8, 2e-8),
        common=2.7e-6,
        common_std=3e-7,
        between_std=4e-7,
        p_value=1e-9,
    )
    text = words(diagnosed("explained", SOFT, between_recordings=(two,)))
    assert "What next: find out why A2 compliance differs between the recordings: another tool" in text


def test_parameters_of_one_effect_that_was_not_tested_are_one_entry():
    preload = ExclusionLimit(
        name="gravity_compensator", where=("A2",), parameter="A2.preload_deg", value=1.0, workspace_mm=None, length_mm=None, tested=False
    )
    text = words(diagnosed("none", before=0.009, exclusion_limits=(preload, replace(preload, parameter="A2.stretched_deg"))))
    assert "gravity_compensator at A2 (preload, stretched)" in text


def test_centres_that_the_fit_rejects_are_in_the_held_out_figures_and_the_robust_ones_have_that_name():
    found = diagnosed("explained", SOFT)
    held = replace(found.fit.held_out, centres=440, robust_centres=419, every_before_rms_mm=2.752, every_after_rms_mm=1.9)
    text = words(replace(found, fit=replace(found.fit, held_out=held)))
    assert "20.0 µm before, 9.0 µm after (robust, over 419 centres; 2752.0 µm before, 1900.0 µm after over all 440 centres)" in text
    assert "On held-out data (by station): 2752.0 µm before, 1900.0 µm after over all 440 centres; robust 20.0 µm before" in text
    assert "robust" not in words(found)
