"""A real KUKA, where the recordings are at hand: found in one motion, tested on the other."""

from pathlib import Path

import pytest

from mbcacq.diagnosis.motion import diagnose_trajectories
from mbcacq.recording import read_trajectory_set

pytestmark = pytest.mark.timeout(300)
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


@pytest.fixture(scope="module")
def kr300():
    if not SHARED.is_dir():
        pytest.skip(f"the measured data are not in {SHARED}")
    return diagnose_trajectories([read_trajectory_set(SHARED / f"kr300-trajectory-{k}") for k in "ab"])


def test_joint_side_angles_are_explained_to_five_thousandths_of_a_degree(kr300):
    for fit in kr300["fit"]["channels"]:
        if fit["channel"] == "q_joint":
            assert fit["held_out"]["before_rms"] > 0.03
            assert fit["held_out"]["after_rms"] <= 0.005
    late = next(e for e in kr300["effects"] if e["name"] == "channel_latency")
    assert late["where"] == ["q_joint"]
    assert late["parameters"]["latency_s"]["value"] == pytest.approx(0.003, abs=2e-4)


def test_torque_and_following_are_explained_in_part(kr300):
    for fit in kr300["fit"]["channels"]:
        if fit["channel"] == "tau":
            assert fit["held_out"]["after_rms"] < 0.5 * fit["held_out"]["before_rms"]
        if fit["channel"] == "q_set":
            assert fit["held_out"]["after_rms"] < 0.85 * fit["held_out"]["before_rms"]
    assert kr300["verdict"] == "partly_explained"
