"""The error motions of a track and of a turntable, made in plain numpy; the tool names them at their axis."""

from importlib import import_module
from pathlib import Path

import pytest

from mbcacq.diagnosis.diagnose import diagnose

ROOT = Path(__file__).parents[2]


@pytest.fixture
def blind(monkeypatch):
    """The cells of ``benchmarks/external_effects.py``."""
    for folder in ("tests/calibration", "benchmarks"):
        monkeypatch.syspath_prepend(ROOT / folder)
    return import_module("external_effects")


@pytest.mark.parametrize(
    ("cell", "seed", "motion"),
    [("track", 5005, "horizontal_straightness_rms_mm"), ("table", 5012, "wobble_2_rms_rad"), ("track", 5009, "")],
)
def test_what_an_external_axis_does_is_named_there_and_nothing_where_nothing_is(blind, cell, seed, motion):
    concealed, obs = blind.made(cell, seed)
    named = [e for e in diagnose(obs, folds=2).effects if e.name != "unknown"]
    assert [(e.name, e.where, list(e.parameters)) for e in named] == (
        [("axis_error_motion", (concealed.axis,), [f"{concealed.axis}.{motion}"])] if motion else []
    )
    for estimate in (estimate for e in named for estimate in e.parameters.values()):  # poses see a part of the rail, not its whole length
        assert estimate.value == pytest.approx(concealed.size, rel=0.35)
