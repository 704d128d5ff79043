"""A whole run over a network that loses, repeats, delays and reorders datagrams measures what it measures over a good one."""

from contextlib import contextmanager
from pathlib import Path

import numpy as np
import yaml
from lossy import Relay, Weather
from mbcacq_fakes.cell.computed_run import observe
from mbcacq_fakes.cell.ports import free_port

from mbcacq.devices import load_driver
from mbcacq.plan import expand, load
from mbcacq.recording import load_observations
from mbcacq.recording.rrd.reader import Recording
from mbcacq.workflow import acquire

PLANS = Path(__file__).resolve().parents[2] / "plans"
BAD = Weather(loss=0.01, repeat=0.01, reorder=0.01, jitter_s=0.002, hold_s=0.09)  # longer than an answer is waited for
SEED, NOISE_MM = 3, 0.15  # a ball's centre scatters by 0.01 mm; the next pose's is 10 mm away


def two_poses(folder):
    """Lock-step; the controller waits 60 ms for an answer and counts those that are missing in a row, as RSI can be configured."""
    plan = yaml.safe_load((PLANS / "quick.yaml").read_text())
    plan["robot"] |= {"model": str(PLANS / plan["robot"]["model"]), "speed": 1.0}
    plan["robot"]["options"] |= {"late_limit": 1000, "cycle_ms": 4}
    plan["artefacts"] = [str(PLANS / name) for name in plan["artefacts"]]
    plan["exposures"] = 1
    plan["steps"] = [plan["steps"][1] | {"views": plan["steps"][1]["views"][:2]}]
    plan["fake"] = {"robot": {"answer_wait_s": [0.06, 0.06], "counting": "consecutive", "timeout": 100}}
    path = folder / "two.yaml"
    path.write_text(yaml.safe_dump(plan, sort_keys=False))
    return path


@contextmanager
def network(cell):
    """The drivers' options with a bad network in front of the controller, and how many datagrams it has lost."""
    overrides, client = cell.overrides(), free_port()
    carrier = Relay(client, BAD, port=overrides["robot"]["port"])
    carrier.start()
    try:
        yield {**overrides, "robot": {**overrides["robot"], "port": client}}, carrier.lost
    finally:
        carrier.close()


def test_a_run_over_a_bad_network_ends_well_and_measures_the_true_centres(tmp_path):
    loaded = load(two_poses(tmp_path))
    poses = expand(loaded)
    with load_driver("fakes", "cell")(loaded, poses, realtime=False, seed=SEED) as cell, network(cell) as (overrides, lost):
        acquisition = acquire.plan_acquisition(loaded, poses, frozenset(), 0, "the fake cell")
        acquisition.folder = acquire.new_run_folder(tmp_path / "run", "bad network")
        acquisition.execute(overrides)
    found, true = load_observations(acquisition.folder), observe(loaded.cell, poses, seed=SEED)
    expected = dict(zip(zip(true.pose.tolist(), true.ball.tolist(), strict=True), true.xyz, strict=True))
    assert found.pose_id.tolist() == [pose.number for pose in poses]
    assert len(found.xyz) >= 4 * len(poses)
    for pose, ball, xyz in zip(found.pose.tolist(), found.ball.tolist(), found.xyz, strict=True):
        assert np.abs(xyz - expected[pose, ball]).max() < NOISE_MM
    cycles = Recording(acquisition.folder / "run.rrd").cycles().columns
    assert min(lost.values()) >= 5
    assert cycles["lost_telegrams"][-1] >= 5
    assert cycles["repeated_telegrams"][-1] > 0
    assert cycles["old_telegrams"][-1] > 0
