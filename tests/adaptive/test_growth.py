"""A plan grows by the steps of another one of the same cell, and by no other."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbcacq.errors import ConfigError
from mbcacq.model import yaml12
from mbcacq.plan import expand, load
from mbcacq.plan.growth import grown, with_steps

PLANS = Path(__file__).parents[2] / "plans"
MORE = {"name": "visit 1, p1", "phase": "position", "do": "joints", "station": "p1", "poses_deg": [[0.0, -70.0, 110.0, 0.0, 50.0, 0.0]]}


def changed(loaded, **keys):
    return load(loaded.path, yaml12.dump({**yaml12.load(loaded.text), **keys}, allow_unicode=True))


@pytest.mark.parametrize("name", ["quick.yaml", "concealed.yaml"])
def test_further_steps_stand_after_the_plans_own_and_its_comments_stay(name):
    loaded = load(PLANS / name)
    text = with_steps(loaded, [MORE])
    assert yaml12.load(text) == {**yaml12.load(loaded.text), "steps": [*yaml12.load(loaded.text)["steps"], MORE]}
    comments = [line.strip() for line in loaded.text.splitlines() if line.strip().startswith("#")]
    assert all(line in text for line in comments)


def test_poses_that_were_there_keep_their_numbers_and_postures():
    loaded = load(PLANS / "quick.yaml")
    own = expand(loaded)
    further = changed(loaded, steps=[MORE])
    more = grown(loaded, further, len(own))
    assert more.grown_from == len(own)
    assert [(p.number, p.station, p.q.tolist()) for p in expand(more)[: len(own)]] == [(p.number, p.station, p.q.tolist()) for p in own]
    assert len(expand(more)) == len(own) + 1
    assert grown(more, further, len(expand(more))).grown_from == len(own)


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"hand_eye": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation_mm": [0, 0, 100]}}, "hand_eye"),
        ({"exposures": 5}, "exposures"),
        ({"stations": [{"id": "p1", "artefact": "mbc", "pose_in_base": {"translation_mm": [601, 0, 150]}}]}, "stations"),
    ],
)
def test_a_plan_of_another_cell_does_not_extend_a_recording(keys, named):
    loaded = load(PLANS / "quick.yaml")
    with pytest.raises(ConfigError, match=f"'{named}' is not as in the plan of the recording"):
        grown(loaded, changed(loaded, steps=[MORE], **keys), 10)


def test_poses_that_judge_extend_nothing():
    loaded = load(PLANS / "quick.yaml")
    with pytest.raises(ConfigError, match="verification"):
        grown(loaded, changed(loaded, steps=[{**MORE, "phase": "verification"}]), 10)
