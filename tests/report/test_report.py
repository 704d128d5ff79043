"""The report agrees with the result, is one file that loads nothing, and escapes every text from files."""

import copy
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from made_up import diagnosis, motion, pictures
from result_page import AFTER, BEFORE, Page, make_observations, make_result, page

from mbcacq.diagnosis.motion.combine import PosesAndMotion
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.quantities import fixed as fixed_point
from mbcacq.quantities import signed
from mbcacq.report.content import Spacing
from mbcacq.report.sources.coefficients import names_in_words
from mbcacq.report.sources.from_motion import motion_pictures
from mbcacq.report.sources.run_folder import read_run_identity
from mbcacq.report.verdict import beyond_expected_sentence, one_sign
from mbcacq.report.write import report_from_result


def headline(verdict):
    return {"none": "No effect", "explained": "Explained", "cannot_tell": "Cannot tell"}.get(verdict, "Partly explained")


def test_the_report_of_a_run_holds_the_motion_between_its_poses_too(tmp_path):
    """As it is kept: JSON alone, read again."""
    of_motion = motion()
    weak = replace(of_motion.named_effects[0], where=("A3",), parameters={"A3.coulomb_Nm": ParameterEstimate(5.0, 4.0)})
    of_motion = replace(of_motion, effects=(weak, *of_motion.effects))
    info = {
        "diagnosis": diagnosis() | PosesAndMotion(Diagnosis.from_json(diagnosis()), of_motion).to_json(),
        "pictures": pictures() | {"motion": motion_pictures(of_motion)},
    }
    info = json.loads(json.dumps(info, allow_nan=False))
    html = report_from_result(make_result(), path=tmp_path / "report.html", run_info=info).read_text(encoding="utf-8")
    words = Page(html).words
    assert words.index("Joint compliance at A2") < words.index("Motion between the poses") < words.index("Friction at A2")
    assert words.index("Friction at A2") < words.index("Trend: friction at A3")
    assert f"Verdict on poses and motion as one problem {headline(info['diagnosis']['together']['verdict'])}" in words
    for c in of_motion.fit.channels:
        assert f'id="figure-motion_{c.channel}_{c.at}"' in html
    del info["pictures"]["motion"]["channels"][0]["before"][3]  # damaged: the tables stay
    html = report_from_result(make_result(), path=tmp_path / "report.html", run_info=info).read_text(encoding="utf-8")
    assert "Friction at A2" in Page(html).words
    assert "figure-motion" not in html


def test_coefficients_of_effects_are_named_in_words_and_never_two_alike():
    names = [
        "a_1",
        "hand_eye.x",
        "joint_compliance:A2:gravity_torque_2",
        "gear_transmission_error:A1:q1:order=2[0]",
        "scanner_warmup:scanner:time:time_constant_s=177.931[2]",
        "thermal_growth:link2:time",
        "thermal_growth:link2:room_C",
    ]
    assert names_in_words(names) == [
        "a_1",
        "hand_eye.x",
        "joint compliance at A2",
        "gear transmission error at A1, order 2 (1)",
        "scanner warmup at scanner, time constant 178 s (3)",
        "thermal growth at link2, over time",
        "thermal growth at link2, over temperature room",
    ]


def test_the_table_is_that_of_the_published_experiment(tmp_path):
    words = page(tmp_path, make_result()).words
    for number in BEFORE + AFTER:
        assert f"+{number:.4f}" in words
    assert "mean of magnitudes 0.8090 0.3942" in words
    assert "maximum 1.0410 0.4570" in words
    assert "735.2364" in words


@pytest.mark.parametrize(
    ("limit", "level", "headline"),
    [(0.5, "pass", "Passed"), (0.4, "fail", "Not passed"), (0.457, "undecided", "Undecided: "), (None, "none", "Calibrated and verified")],
)
def test_the_verdict_considers_the_uncertainty_of_judging(tmp_path, limit, level, headline):
    report = page(tmp_path, make_result(limit), observations=make_observations())
    assert headline in report.words
    assert f'class="verdict {level}"' in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_a_result_without_a_budget_is_not_decided(tmp_path):
    result = make_result(0.5)
    for place in result["verification"]["places"]:
        del place["judging_mm"]
    del result["verification"]["budget"]
    words = page(tmp_path, result, observations=make_observations()).words
    assert "Undecided: " in words
    assert "calibrate the recording anew" in words


def test_the_budget_names_every_term_and_the_assumed_temperature(tmp_path):
    words = page(tmp_path, make_result()).words
    for term in ("certified distance", "temperature of the artefact", "probing of the spheres", "repeatability of the arm"):
        assert term in words
    assert "15 to 25 °C is assumed" in words
    assert "U = 0.0080 mm" in words
    assert words.count("0.4570 ± 0.0080 mm") == 2  # page one: in the verdict, and as its number


def test_a_place_beyond_its_own_expected_uncertainty_is_marked(tmp_path):
    result = make_result()
    for place in result["verification"]["places"]:
        place["expected_mm"] = 0.3
    assert "beyond the expanded uncertainty" not in page(tmp_path, result).words
    result["verification"]["places"][1]["expected_mm"] = 0.056
    words = page(tmp_path, result).words
    assert "At 1 of 5 places the error is beyond the expanded uncertainty that the calibration expects there: b2" in words
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count('<tr class="beyond">') == 1


def test_the_page_is_about_the_cell_with_its_effects_where_the_run_has_it(tmp_path):
    better = make_result()
    better["effects"] = {"format": "mbcacq-effect-model/1", "terms": [], "recording": {}}
    for place in better["verification"]["places"]:
        place["after_mm"] = 0.0188
    info = {"folder": "runs/today", "with_effects": better}
    words = page(tmp_path, make_result(), run_info=info).words
    assert "Largest sphere spacing error 0.0188 ± 0.0080 mm (k = 2)" in words
    assert "without the effects 0.4570 mm" in words
    assert "mbcacq export runs/today/with-effects --results results" in words


def test_without_verification_nothing_is_claimed(tmp_path):
    result = make_result()
    result["verification"] = None
    words = page(tmp_path, result).words
    assert "Calibrated, not verified" in words
    assert "Passed" not in words


def test_verification_on_the_poses_of_the_fit_is_labelled_as_such(tmp_path):
    result = make_result()
    assert "were not used in the calibration" in page(tmp_path, result).words
    result["verification"]["places"][0]["station"] = "s1"
    assert "took part in the calibration" in page(tmp_path, result).words


def test_the_accuracy_that_the_page_states_includes_the_misfit_that_it_shows(tmp_path):
    """Residuals of 0.1 mm where 0.02 mm were stated: no point is known within 0.03 mm."""
    result = make_result()
    result["fit"] |= {"rms_mm": 0.1, "expected_accuracy_mm": 0.015}
    stated = page(tmp_path, result | {"noise": result["noise"] | {"check_factor": [1.0, 1.1, 1.0]}})
    misfit = page(tmp_path, result | {"noise": result["noise"] | {"check_factor": [5.0, 4.0, 3.0]}})
    assert "30 µm" in stated.words
    assert "200 µm with 98.0 µm (3D rms) of the residual" in misfit.words  # 2 sqrt(0.015² + 0.1² (1 - 1 / 5²)) = 0.198 mm, two digits
    assert "30 µm" not in misfit.words


def test_parameters_with_their_expanded_uncertainties(tmp_path):
    words = page(tmp_path, make_result()).words
    assert "+0.143 ± 0.011" in words
    assert "−0.0170 ± 0.0018" in words  # degrees
    assert "+0.4 ± 1.4" in words  # micrometres of a ball
    assert "theta_1 turns base and stations together" in words
    assert "264.7998" in words
    assert "a_1 and hand_eye.x −0.987" in words
    assert "pose 41 ball 2" in words


def test_the_residual_of_held_out_poses_is_reported(tmp_path):
    assert "held out" not in page(tmp_path, make_result()).words
    result = make_result() | {"held_out": {"split": "station", "poses": 64, "rms_mm": 0.0213}}
    assert "poses held out, 3D rms 21.3 µm (64 poses, by station)" in page(tmp_path, result).words


def test_a_fit_of_the_hand_eye_transform_alone_says_that_the_arm_is_nominal(tmp_path):
    result = make_result() | {"verification": None, "scope": "all poses are at one station"}
    for parameter in result["parameters"]:
        if re.fullmatch(r"(theta|d|a|alpha|beta)_\d", parameter["name"]):
            parameter |= {"status": "held", "std": None, "reason": "kinematics not asked for"}
    words = page(tmp_path, result).words
    assert "All poses are at one station." in words
    assert "the arm is taken as nominal" in words
    assert "not asked for" not in words
    assert "Kinematic errors" not in words


def test_name_start_versions_and_plan_come_from_the_run_folder(tmp_path):
    assert read_run_identity(tmp_path / "nowhere") == {}
    (tmp_path / "plan.yaml").write_text("format: mbcacq-plan/1\n")
    (tmp_path / "journal.jsonl").write_text(
        '{"event": "run_started", "name": "cell 7", "started": "2026-11-21T07:45:48+00:00", "versions": {"numpy": "2.4.6"}}\n{"torn'
    )
    info = read_run_identity(tmp_path)
    assert info == {
        "name": "cell 7",
        "started": "2026-11-21T07:45:48+00:00",
        "versions": {"numpy": "2.4.6"},
        "plan_yaml": "format: mbcacq-plan/1\n",
    }
    words = page(tmp_path, make_result(), run_info=info).words
    assert "cell 7 · 2026-11-21 07:45 UTC" in words
    assert "format: mbcacq-plan/1" in words
    (tmp_path / "journal.jsonl").write_text("torn")
    assert list(read_run_identity(tmp_path)) == ["plan_yaml"]


def test_residuals_need_the_recording(tmp_path):
    assert "Residuals" not in page(tmp_path, make_result()).words
    words = page(tmp_path, make_result(), observations=make_observations()).words
    assert "Residuals" in words
    assert "Every pose on the range of each axis" in words


def test_residuals_are_measured_minus_predicted():
    from mbcacq.calibration.result_io import state_from_dict
    from mbcacq.report.sources.measured import residuals

    obs, result = make_observations(), make_result()
    result["noise"] |= {"scanner_mm": [0.005, 0.005, 0.009], "joint_rad": [0.0] * 6}
    result["rejected"] = [{"pose": pose, "ball": ball, "distance_mm": 1.0} for pose, ball in ((3, 2), (5, None))]
    shifted = replace(obs, xyz=obs.xyz + [0.0, 0.0, 0.1])
    found = residuals(shifted, result, state_from_dict(result, obs.cell))
    assert len(found.xyz) == 20  # ten poses, two balls; the verification poses are not the fit's
    np.testing.assert_allclose(found.xyz.mean(axis=0), [0, 0, 0.1], atol=0.006)
    np.testing.assert_allclose(found.weighted, found.xyz / [0.005, 0.005, 0.009])
    assert found.outlier.sum() == 3


def test_one_file_that_loads_nothing(tmp_path):
    report = page(tmp_path, make_result(), observations=make_observations())
    assert report.loads == []
    assert "link" not in report.tags
    assert "iframe" not in report.tags
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "@import" not in html[: html.index("</style>")]
    assert html.count("plotly.js v") == 1


def test_text_from_files_stays_text(tmp_path):
    evil = '<script>alert("x")</script><img src="http://example.org/x.png">'
    result = make_result()
    result["robot"]["name"] = evil
    result["parameters"][0]["reason"] = evil
    result["correlated"][0]["parameters"] = [evil, "b"]
    result["verification"]["places"][0]["station"] = evil
    result["names"][0] = evil
    result["warnings"] = [evil]
    info = {"name": evil, "started": evil, "plan_yaml": evil, "versions": {evil: evil}, "facts": {evil: evil}}
    obs = make_observations()
    phase = obs.phase.astype(object)
    phase[:3] = evil
    named = replace(obs.cell, robot=replace(obs.cell.robot, name=evil))
    report = page(tmp_path, result, run_info=info, observations=replace(obs, cell=named, phase=phase))
    clean = page(
        tmp_path,
        make_result(),
        run_info=dict.fromkeys(["name", "plan_yaml"], "a") | {"versions": {"a": "a"}, "facts": {"a": "a"}},
        observations=make_observations(),
    )
    assert "img" not in report.tags
    assert report.tags.count("script") == clean.tags.count("script")
    assert report.loads == []
    assert 'alert("x")' in report.words


def test_figures_carry_no_markup_of_names(tmp_path):
    result = make_result()
    result["names"][0] = "<b>bold</b>"
    report_from_result(result, path=tmp_path / "r.html")
    html = (tmp_path / "r.html").read_text(encoding="utf-8")
    figure = html[html.index('id="figure-correlation"') :]
    assert "<b>bold" not in figure


def test_a_file_that_is_no_result_is_refused(tmp_path):
    for wrong in ({}, [], {"format": "mbcacq-result/9"}):
        with pytest.raises(ConfigError, match="not a calibration result"):
            report_from_result(wrong, path=tmp_path / "r.html")


@pytest.mark.parametrize("key", ["robot", "parameters", "fit", "noise", "T_flange_scanner", "names", "covariance"])
def test_a_damaged_result_is_named(tmp_path, key):
    for value in (None, "x", [1]):
        result = copy.deepcopy(make_result())
        result[key] = value
        with pytest.raises(ConfigError, match="damaged"):
            report_from_result(result, path=tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_a_result_survives_its_file(tmp_path):
    a = report_from_result(make_result(), path=tmp_path / "a.html").read_text(encoding="utf-8")
    b = report_from_result(json.loads(json.dumps(make_result())), path=tmp_path / "b.html").read_text(encoding="utf-8")
    assert Page(a).words == Page(b).words


def test_a_path_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        report_from_result(make_result(), path=tmp_path / "file" / "r.html")


def test_many_stations_share_one_limit_line(tmp_path):
    result = make_result()
    result["verification"]["limit_mm"] = 0.3
    assert "Limit ±0.300 mm" in page(tmp_path, result).words


def test_what_rounds_to_zero_has_no_sign():
    assert [fixed_point(v) for v in (-0.0004, -0.0, -0.0006)] == ["0.000", "0.000", "−0.001"]
    assert [signed(v) for v in (-0.0004, 0.0, 0.02, -0.02, None)] == ["0.000", "0.000", "+0.020", "−0.020", "–"]


def made_spacing(after, common=None):
    n = len(after)
    return Spacing([f"b{k}" for k in range(n)], np.full(n, 735.0), np.full(n, 0.5), np.array(after), np.full(n, 0.01), common=common)


def test_places_beyond_their_expectation_are_chance_or_a_lack_by_their_number():
    """Beyond k = 2 lie 4.55 % of normal errors: one of ten places in 37 % of calibrations, three of ten in 0.8 %."""
    assert "Chance alone leaves as many in about 37%" in beyond_expected_sentence(made_spacing([0.03] + [0.0] * 9))
    assert "The model lacks something" in beyond_expected_sentence(made_spacing([0.03] * 3 + [0.0] * 7))
    assert beyond_expected_sentence(made_spacing([0.01] * 10)) == ""


def test_errors_of_one_sign_are_explained_by_the_uncertainty_that_all_places_share_or_have_a_cause():
    assert "U = 30 µm (k = 2), which explains it" in one_sign(made_spacing([0.02] * 10, common=0.015))
    assert "A common cause acts like this" in one_sign(made_spacing([0.04] * 10, common=0.015))
    assert one_sign(made_spacing([0.02] * 9 + [-0.02], common=0.015)) == ""
