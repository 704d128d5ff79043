"""Scoring on diagnoses written by hand."""

import json

import pytest

from mbcacq.challenge.score import parameter_errors, score
from mbcacq.challenge.table import cells, row, summary

COMPLIANCE = {"name": "joint_compliance", "where": ["A2", "A3"], "compliance_rad_per_Nm": {"A2": 1.6e-6, "A3": 2.0e-6}}


def diagnosis(effects: str, verdict: str = "explained", at: str = "A2", before: float = 11.0, after: float = 1.5) -> dict:
    return json.loads(f"""{{"format": "mbcacq-diagnosis/1", "verdict": "{verdict}",
        "mismatch": [{{"at": "{at}", "depends_on": "gravity_torque_2", "share": 0.7, "p_value": 1e-12}}], "effects": {effects},
        "fit": {{"held_out": {{"before_chi2_dof": {before}, "after_chi2_dof": {after}, "split": "station"}}}}}}""")


FOUND = """[{"name": "joint_compliance", "where": ["A3", "A2"], "parameters": {
    "A2.compliance_rad_per_Nm": {"value": 1.7e-6, "std": 5e-8}, "A3.compliance_rad_per_Nm": {"value": 2.4e-6, "std": 1e-7}}}]"""
OTHER = """[{"name": "joint_scale", "where": ["A2"], "parameters": {"A2.ratio": {"value": 1e-4, "std": 1e-5}}}]"""


def test_right_name_and_place():
    s = score("joint_compliance", [COMPLIANCE], diagnosis(FOUND), achievable=10 / 11)
    assert s.counts
    assert s.named
    assert s.placed
    assert s.located
    assert not s.confident
    assert s.share == pytest.approx((1 - 1.5 / 11) / (10 / 11))
    assert s.sigmas == pytest.approx({"joint_compliance.A2.compliance_rad_per_Nm": 2.0, "joint_compliance.A3.compliance_rad_per_Nm": 4.0})


def test_right_name_at_a_joint_that_is_rigid_is_not_the_right_place():
    s = score("joint_compliance", [{**COMPLIANCE, "where": ["A3"]}], diagnosis(FOUND), 0.9)
    assert s.named
    assert not s.placed


def test_a_wrong_name_first_spoils_it_even_if_the_right_one_follows():
    s = score("joint_compliance", [COMPLIANCE], diagnosis(OTHER[:-1] + ", " + FOUND[1:]), 0.9)
    assert not s.named
    assert s.extra == ["joint_scale"]
    assert s.confident


def test_a_wrong_name_is_confident_only_where_the_verdict_is_explained():
    wobble = {"name": "axis_wobble", "where": ["link2"], "depends_on": ["q2"]}
    for verdict, confident in (("explained", True), ("partly_explained", False), ("unexplained", False)):
        s = score("axis_wobble", [wobble], diagnosis(OTHER, verdict, at="link2"), 0.5, catalogued=False)
        assert s.confident is confident
        assert s.located
        assert not s.named


def test_unknown_is_no_name():
    s = score(
        "axis_wobble",
        [{"name": "axis_wobble", "where": ["link2"]}],
        diagnosis('[{"name": "unknown", "where": ["link2"], "parameters": {}}]', "unexplained", at="A3"),
        0.5,
        catalogued=False,
    )
    assert s.extra == []
    assert not s.located


def test_a_clean_cell_with_a_verdict_other_than_none_is_a_false_alarm():
    assert score("none", [], diagnosis("[]", "unexplained"), 0.0).detected
    quiet = score("none", [], diagnosis("[]", "none"), 0.0)
    assert not quiet.detected
    assert not quiet.counts
    assert row("none", [quiet, quiet])["false alarms"] == 0.0


def test_what_the_true_model_would_hardly_improve_does_not_count():
    weak = score("joint_compliance", [COMPLIANCE], diagnosis("[]", "none"), 0.09)
    assert not weak.counts
    assert row("joint_compliance", [weak])["named"] is None


def test_two_effects_may_come_in_either_order_but_before_any_other():
    scale = {"name": "joint_scale", "where": ["A2"], "ratio": 1.2e-4}
    both = diagnosis(OTHER[:-1] + ", " + FOUND[1:])
    assert score("two", [COMPLIANCE, scale], both, 0.5).placed
    assert not score("two", [COMPLIANCE, {"name": "backlash", "where": ["A1"], "width_deg": 0.01}], both, 0.5).named


def test_the_smaller_of_two_must_be_reported_where_it_adds_something():
    scale = {"name": "joint_scale", "where": ["A2"], "ratio": 1.2e-4}
    alone = diagnosis(FOUND)

    assert score("two", [{**COMPLIANCE, "adds": 0.6}, {**scale, "adds": 0.02}], alone, 0.6).placed
    assert not score("two", [{**COMPLIANCE, "adds": 0.6}, {**scale, "adds": 0.2}], alone, 0.7).named


def test_a_coupling_needs_both_of_its_joints():
    reported = '[{"name": "wrist_coupling", "where": ["A4", "A5"], "parameters": {"ratio": {"value": 4.0e-4, "std": 1e-5}}}]'
    assert score("wrist_coupling", [{"name": "wrist_coupling", "where": ["A4", "A5"], "ratio": 4.1e-4}], diagnosis(reported), 0.5).placed
    assert not score(
        "wrist_coupling", [{"name": "wrist_coupling", "where": ["A4", "A6"], "ratio": 4.1e-4}], diagnosis(reported), 0.5
    ).placed


def test_phases_are_compared_around_the_circle_and_by_order():
    truth = {
        "name": "gear_transmission_error",
        "where": ["A3"],
        "order": [2.0, 100.0],
        "amplitude_deg": [0.02, 0.01],
        "phase_deg": [179.0, 0.0],
    }
    reported = {
        "A3.order": {"value": [100.0, 2.0], "std": [0, 0]},
        "A3.amplitude_deg": {"value": [0.011, 0.02], "std": [0.0005, 0.001]},
        "A3.phase_deg": {"value": [3.0, -179.0], "std": [2.0, 1.0]},
    }
    assert parameter_errors(truth, reported) == pytest.approx(
        {"A3.amplitude_deg[2]": 0.0, "A3.phase_deg[2]": 2.0, "A3.amplitude_deg[100]": 2.0, "A3.phase_deg[100]": 1.5}
    )


def test_vectors_count_by_their_worst_component_and_not_without_a_sigma():
    truth = {"name": "scanner_warmup", "where": ["scanner"], "offset_mm": [0.1, 0.0, -0.2], "time_constant_s": 500.0}
    reported = {"offset_mm": {"value": [0.11, 0.0, -0.21], "std": [0.01, 0.01, 0.002]}, "time_constant_s": {"value": 300.0, "std": 0.0}}
    assert parameter_errors(truth, reported) == pytest.approx({"offset_mm": 5.0})


def test_the_table_has_a_row_a_kind_and_one_for_all():
    scores = [
        score("joint_compliance", [COMPLIANCE], diagnosis(FOUND), 0.9),
        score("joint_compliance", [COMPLIANCE], diagnosis(OTHER), 0.9),
    ]
    rows = summary(scores)
    assert [r["kind"] for r in rows] == ["joint_compliance", "all catalogued"]
    assert rows[0]["named"] == 0.5
    assert rows[0]["parameters within 3 sigma"] == 0.5
    assert ["joint_compliance", "2", "2", "50 %"] in [cells(entry)[:4] for entry in rows]
