"""A pause of the recording is said, with what changed meanwhile."""

from dataclasses import replace

import numpy as np
import simulated

from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.output.notes import confounded_pauses, pauses
from mbcacq.effects.effect import ParameterEstimate


def paused(at: int):
    obs = simulated.plan(4, 0, 7)
    later = np.arange(obs.n_poses) >= at
    air = np.where(later, 21.4, 22.3)
    return replace(obs, time_s=obs.time_s + 30240.0 * later, temperatures={"air_C": air})


def test_a_pause_is_found_with_the_temperatures_on_either_side():
    assert pauses(paused(15)) == [(15, "a pause of 8.4 h after pose 14, air_C went from 22.3 to 21.4 °C")]


def test_a_change_at_the_pause_is_said_to_be_confounded():
    shift = EffectFound(
        name="mount_shift", where=("mount",), parameters={"mount.at_pose": ParameterEstimate(17.0, 0.5)}, p_value=1e-9, held_out_gain=0.5
    )
    (sentence,) = confounded_pauses(paused(15), [shift])
    assert "the change at pose 17 may be a displacement, thermal growth or a new mastering" in sentence


def test_a_recording_without_pause_has_none():
    assert pauses(simulated.plan(4, 0, 7)) == []
