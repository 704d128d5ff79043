"""What the page says of an effect: its alternatives by their odds, the components of a vector."""

from made_up import diagnosis

from mbcacq.report.cards import diagnosis_cards
from mbcacq.report.sources.from_diagnosis import diagnosis_content


def test_an_alternative_is_stated_by_its_odds():
    content = diagnosis()
    content["effects"][0]["alternatives"] = [
        {"name": "unknown", "where": ["A1"], "held_out_gain": 0.0, "odds": 1 / 652},
        {"name": "joint_step", "where": ["A2"], "held_out_gain": 0.0, "odds": 0.0},
    ]
    effect = diagnosis_content(content, None).effects[0]
    assert effect.alternatives == ["an unmodelled effect at A1 (odds 1 : 650)", "joint step at A2 (excluded)"]


def test_components_of_a_vector_are_no_harmonics():
    content = diagnosis()
    content["effects"][0]["parameters"] = {"offset_mm": {"value": [0.0098, -0.003, 0.0102], "std": [0.0033, 0.0033, 0.0048]}}
    effect = diagnosis_content(content, None).effects[0]
    assert [(name, unit) for name, _, _, unit in effect.parameters] == [("offset x", "mm"), ("offset y", "mm"), ("offset z", "mm")]
    assert effect.harmonics is None


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
    shown = diagnosis_content(content, None)
    said = [("Joint compliance at A2", ""), ("Trend: scanner warmup at scanner", "no figure is beyond its expanded uncertainty (k = 2)")]
    assert [(e.title, e.trend) for e in shown.effects] == said
    assert shown.effects[1].parameters == []
    cards = diagnosis_cards(shown)
    assert "## 1. Joint compliance at A2" in cards
    assert "## Trend: scanner warmup at scanner" in cards
