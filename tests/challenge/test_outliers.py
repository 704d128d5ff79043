"""Gross outliers beside an effect."""

from pathlib import Path

from mbcacq.challenge.run import Challenger
from mbcacq.challenge.scenarios import Scenario

SEEING = Path(__file__).parents[2] / "plans" / "seeing.yaml"


def test_an_effect_is_found_beside_gross_outliers():
    """Rejected centres leave a bar's turn about itself without any centre that it moves: its coefficient once grew without bound."""
    scenario = Scenario(2, "mount_compliance", 1113987278, ("mount_compliance",), 560227449, excess=5.473584119422342, outliers=0.01)

    outcome = Challenger.of(SEEING).take(scenario)

    assert outcome.score.placed
    assert outcome.diagnosis["verdict"] == "explained"
