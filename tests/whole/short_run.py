"""A run of four poses in this process, each seen once, hurt at a chosen event."""

import time

import numpy as np
from dry_runs import few_views, plan_file

from mbcacq.acquisition import events
from mbcacq.devices import load_driver
from mbcacq.errors import MbcacqError
from mbcacq.plan import expand, load
from mbcacq.recording import load_observations as load_run
from mbcacq.recording.rrd.reader import Recording
from mbcacq.workflow import acquire


def short(plan):
    few_views(plan)
    plan["scanner"] |= {"reconnect_s": 20.0}
    plan["scanner"]["options"] |= {"timeout_s": 1.5}
    plan["sensors"] = [
        {
            "driver": "modbus",
            "options": {
                "host": "127.0.0.1",
                "port": 5020,
                "timeout_s": 0.3,
                "retries": 0,
                "values": {"robot_C": {"address": 0, "table": "input", "type": "int16", "scale": 0.1}},
            },
        }
    ]


def run_with(tmp_path, hurt, change=lambda plan: None, at=(events.PoseDone, 1)):
    """Run; ``hurt(cell)`` is called once, at the first event of that kind and pose. Returns the error that ended it, and the folder."""
    loaded = load(plan_file(tmp_path, lambda p: (short(p), change(p))))
    poses = expand(loaded)
    acquisition = acquire.plan_acquisition(loaded, poses, frozenset(), 0, "the fake cell")
    acquisition.folder = acquire.new_run_folder(tmp_path / "run", "x")
    done, still = [], []

    def watch(event):
        if isinstance(event, at[0]) and event.pose == at[1] and not done:
            done.append(event.pose)
            hurt(cell)
        if isinstance(event, events.RunStopped):
            before = np.array(cell.arm.read().q)
            time.sleep(0.2)
            still.append(np.abs(np.array(cell.arm.read().q) - before).max())

    with load_driver("fakes", "cell")(loaded, poses, seed=1) as cell:
        try:
            acquisition.execute(cell.overrides(), [watch])
            error = None
        except (MbcacqError, KeyboardInterrupt) as caught:
            error = caught
    assert still == [0.0]  # at the end of the run the arm stands
    return error, acquisition.folder


def readable(folder, poses, status):
    assert load_run(folder).pose_id.tolist() == poses
    assert Recording(folder / "run.rrd").about()["exit_status"] == status
