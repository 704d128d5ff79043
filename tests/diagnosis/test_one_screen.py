"""A diagnosis is one screen: of each data set of the documentation, from the diagnosis that is kept beside its page."""

from pathlib import Path

import pytest

from mbcacq.diagnosis.output.figures import beyond_uncertainty
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.workflow.diagnosis_result import DiagnosisResult

KEPT = sorted((Path(__file__).parents[2] / "docs" / "data").glob("*.words.json"))


@pytest.fixture(params=KEPT, ids=lambda file: file.name.partition(".")[0])
def found(request: pytest.FixtureRequest) -> DiagnosisResult:
    return DiagnosisResult.from_json(request.param.read_text(encoding="utf-8"))


def test_a_diagnosis_fits_a_screen_and_says_how_to_see_the_rest(found):
    lines = found.text.splitlines()
    assert len(lines) <= 40
    assert len(lines) < len(found.in_words(whole=True).splitlines())
    assert lines[-1] == "All figures, limits and notes: --all."
    assert "was not considered" not in found.text  # but in one line
    assert found.in_words(whole=True).startswith(lines[0])


def test_every_finding_is_in_the_first_lines_or_counted(found):
    listed = next(head for head in ("Effects, ± U (k = 2):", "Trends, without a reliable figure:") if head in found.text)
    shown = found.text.split(listed)[1].split("Where model")[0]
    effects = (found.poses or found.motion).effects
    heads = [line for line in shown.splitlines() if line.startswith("  ") and " at " in line and " (p " in line]
    more = [int(line.split()[1]) for line in shown.splitlines() if line.startswith("  and ")]
    assert len(heads) + sum(more) == len(effects)


def test_a_harmonic_goes_with_its_amplitude():
    parameters = {
        "A2.order": ParameterEstimate((26.1, 3.0), (0.1, 1.35)),
        "A2.amplitude_deg": ParameterEstimate((0.00494, 0.006), (0.00016, 0.025)),
        "A2.phase_deg": ParameterEstimate((-121.0, -100.0), (6.5, 145.0)),
        "A3.compliance_rad_per_Nm": ParameterEstimate(12e-6, 7.5e-6),
        "mount.translation_mm": ParameterEstimate((0.0004, -0.0213, 0.0062), (0.0027, 0.0031, 0.0023)),
    }
    shown, below = beyond_uncertainty(parameters)
    assert {name: estimate.components[0] for name, estimate in shown.items()} == {
        "A2.order": (26.1,),
        "A2.amplitude_deg": (0.00494,),
        "A2.phase_deg": (-121.0,),
        "mount.translation_mm": (0.0004, -0.0213, 0.0062),
    }
    assert below == ["A2 order 3.0 ± 2.7", "A3 compliance"]
