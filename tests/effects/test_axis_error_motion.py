"""The error motions of a track and of a turntable, made in plain numpy; the tool names them at their axis."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path[:0] = [str(Path(__file__).parents[2] / folder) for folder in ("benchmarks", "tests/calibration")]
import external_effects as blind

from mbcacq.diagnosis.diagnose import diagnose


@pytest.mark.parametrize(
    ("cell", "seed", "motion"),
    [("track", 5005, "horizontal_straightness_rms_mm"), ("table", 5012, "wobble_2_rms_rad"), ("track", 5009, "")],
)
def test_what_an_external_axis_does_is_named_there_and_nothing_where_nothing_is(cell, seed, motion):
    concealed, obs = blind.made(cell, seed)
    named = [e for e in diagnose(obs).effects if e.name != "unknown"]
    assert [(e.name, e.where, list(e.parameters)) for e in named] == (
        [("axis_error_motion", (concealed.axis,), [f"{concealed.axis}.{motion}"])] if motion else []
    )
    if motion.endswith("_mm"):  # the poses see another part of the rail than its whole length
        (estimate,) = named[0].parameters.values()
        assert estimate.value == pytest.approx(concealed.size, rel=0.35)
