"""What the page says of an effect: its alternatives by their odds, the components of a vector."""

from made_up import diagnosis

from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.model.json_text import from_fields
from mbcacq.report.cards import diagnosis_cards
from mbcacq.report.sources.from_diagnosis import diagnosis_content, trial_content


def test_an_alternative_is_stated_by_its_odds():
    content = diagnosis()
    content["effects"][0]["alternatives"] = [
        {"name": "unknown", "where": ["A1"], "held_out_gain": 0.0, "odds": 1 / 652},
        {"name": "joint_step", "where": ["A2"], "held_out_gain": 0.0, "odds": 0.0},
    ]
    effect = diagnosis_content(Diagnosis.from_json(content), None).effects[0]
    assert effect.alternatives == ["unmodelled effect at A1 (odds 1 : 650)", "joint step at A2 (excluded)"]


def test_components_of_a_vector_are_no_harmonics():
    content = diagnosis()
    components = {"value": [0.0098, -0.003, 0.0102], "std": [0.0033, 0.0033, 0.0048]}
    content["effects"][0]["parameters"] = {"offset_mm": components, "rotation_deg": components}
    effect = diagnosis_content(Diagnosis.from_json(content), None).effects[0]
    expected = [(f"{what} {axis}", unit) for what, unit in (("offset", "mm"), ("rotation", "°")) for axis in "xyz"]
    assert [(name, unit) for name, _, _, unit in effect.parameters] == expected
    assert effect.harmonics is None


def test_only_orders_of_a_joint_are_harmonics():
    """The values of two recordings, and the scale of a scanner along x, y and z, are none."""
    content = diagnosis()
    two, three = {"value": [3e-6, 2.4e-6], "std": [2e-8, 2e-8]}, {"value": [0.0, 0.0, 290.0], "std": [0.0, 0.0, 15.0]}
    content["effects"][0]["parameters"] = {"A2.compliance_rad_per_Nm": two, "scale_ppm": three}
    effect = diagnosis_content(Diagnosis.from_json(content), None).effects[0]
    assert effect.harmonics is None
    assert [row[0] for row in effect.parameters] == ["A2 compliance [1]", "A2 compliance [2]", "scale x", "scale y", "scale z"]
    order = {"value": [100.0, 2.0], "std": [0.1, 0.3]}
    content["effects"][0]["parameters"] = {"A1.order": order, "A1.amplitude_deg": {"value": [0.004, 0.003], "std": [1e-4, 1e-4]}}
    effect = diagnosis_content(Diagnosis.from_json(content), None).effects[0]
    assert effect.harmonics == (
        ["A1 order", "A1 amplitude / °"],
        [["100.00 ± 0.20", "0.00400 ± 0.00020"], ["2.00 ± 0.60", "0.00300 ± 0.00020"]],
    )


def test_a_trend_that_does_not_help_removes_no_share():
    content = diagnosis()
    content["effects"][0] |= {"held_out_gain": 0.27, "held_out_gain_std": 0.3}
    shown = diagnosis_content(Diagnosis.from_json(content), None)
    assert shown.effects[0].trend == "held-out data are predicted as well without it"
    assert "removes" not in diagnosis_cards(shown)


def test_what_differs_between_recordings_is_a_remark():
    content = diagnosis()
    content["between_recordings"] = [
        {
            "name": "joint_compliance",
            "where": ["A2"],
            "parameter": "A2.compliance_rad_per_Nm",
            "values": [3e-6, 2.4e-6],
            "stds": [2e-8, 2e-8],
            "common": 2.7e-6,
            "common_std": 3e-7,
            "between_std": 4e-7,
            "p_value": 1e-9,
        }
    ]
    remarks = diagnosis_content(Diagnosis.from_json(content), None).remarks
    assert any(r.startswith("A2 compliance in the recordings: 3.000 ± 0.040, 2.400 ± 0.040; common") for r in remarks)


def test_a_trend_stands_behind_the_findings_without_a_number():
    """The warm-up is first by its evidence; its size is not beyond twice its standard deviation."""
    content = diagnosis()
    weak = {
        "name": "scanner_warmup",
        "where": ["scanner"],
        "p_value": 1e-9,
        "held_out_gain": 0.02,
        "parameters": {"offset_mm": {"value": [0.018, -0.006, 0.023], "std": [0.025, 0.007, 0.026]}},
        "alternatives": [],
    }
    content["effects"] = [weak, *content["effects"]]
    shown = diagnosis_content(Diagnosis.from_json(content), None)
    said = [("Joint compliance at A2", ""), ("Trend: scanner warmup at scanner", "no figure is beyond its expanded uncertainty (k = 2)")]
    assert [(e.title, e.trend) for e in shown.effects] == said
    assert shown.effects[1].parameters == []
    cards = diagnosis_cards(shown)
    assert "## 1. Joint compliance at A2" in cards
    assert "## Trend: scanner warmup at scanner" in cards


def test_a_trial_on_another_recording_is_a_table():
    def left(mm, chi2):
        return {"rms_mm": mm, "median_mm": mm / 2, "chi2_dof": chi2}

    trial = {
        "place": "fitted",
        "poses": 60,
        "centres": 300,
        "geometry_alone": left(0.9, 61.9),
        "with_effects": left(0.2, 9.6),
        "own_geometry": None,
        "effects": [{"name": "joint_compliance", "where": ["A2"], "without_mm": 0.3, "gain": 0.06}],
        "normalised_error": {"rms": 1.3, "quantile_95": 2.4, "share_below_3": 0.992},
        "warnings": ["q1 leaves the range"],
        "recording": "autumn",
    }
    shown = trial_content(from_fields(Transfer, trial | {"parts_left_out": {"as_learnt": left(0.25, 9.9), "drawn_anew": left(0.1, 4.2)}}))
    assert shown.recording == "autumn"
    assert [row[0] for row in shown.rows] == [
        "the learnt geometry alone",
        "with its effects",
        "with effects, parts left out of the fit",
        "and what was not to be learnt drawn anew",
        "without joint compliance at A2",
    ]
    assert [row[1] for row in shown.rows] == ["900.0 µm", "200.0 µm", "250.0 µm", "100.0 µm", "300.0 µm"]
    assert shown.notes[1:] == ["Error over stated uncertainty: 1.30 rms, 2.40 at 95 %, 99.2% below 3.", "q1 leaves the range."]
    earlier = trial_content(from_fields(Transfer, trial))  # as programs wrote it that drew nothing anew
    assert len(earlier.rows) == 3
