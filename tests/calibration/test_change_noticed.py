"""A change is reported to who measures while the run goes on, and to who tries a calibration on a recording in which something changed."""

import numpy as np
import pytest
from erring_arms import LAWS, erring_arm
from test_change import HAND_EYE_ALONE, cell_of, slipped

from mbcacq.acquisition import events
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.transfer import check_transfer
from mbcacq.workflow.change_watch import ChangeWatch


def warnings_of_run(obs):
    """(number of poses measured, text) of each warning, as the operator gets them."""
    said, done = [], [0]
    bus = EventBus([lambda e: said.append((done[0], e.text)) if isinstance(e, events.Message) else None])
    bus.subscribe(ChangeWatch(obs.cell, bus))
    before = None
    for k in range(obs.n_poses):
        station = obs.cell.stations[obs.station[k]].id
        if station != before:
            bus.emit(events.StationReached, station, "mbc")
            before = station
        rows = obs.pose == k
        found = np.array(obs.cell.ball_ids)[obs.ball[rows]]
        some = np.ones(rows.sum())
        q, still = obs.q[k], np.zeros(6)
        bus.emit(events.PoseDone, k, station, "position", "", q, still, 0.0, found, obs.xyz[rows], some, some, obs.xyz[rows], 1)
        done[0] += 1
    return said


def test_the_operator_is_told_at_the_station_after_the_scanner_slipped_and_once():
    obs, _ = slipped(cell_of(1), 19)
    said = warnings_of_run(obs)
    assert [poses for poses, _ in said] == [24]
    assert "slipped" in said[0][1]
    assert "between pose 18 and pose 19" in said[0][1]


@pytest.mark.parametrize("seed", range(3))
def test_nobody_is_disturbed_by_a_run_in_which_nothing_changes(seed):
    assert warnings_of_run(cell_of(40 + seed).observations) == []


@pytest.mark.parametrize("name", ["elastic A2, A4", "gear errors of orders 2 to 4"])
def test_what_depends_on_posture_is_no_accident(name):
    learn, _, _ = erring_arm(LAWS[name], 1)
    assert warnings_of_run(learn) == []


def test_a_recording_in_which_the_scanner_slipped_is_named_where_a_calibration_is_tried_on_it():
    cell = calibrate(cell_of(2).observations, HAND_EYE_ALONE)
    obs, _ = slipped(cell_of(3), 19)
    assert any("changed while that recording was made" in w and "slipped" in w for w in check_transfer(obs, cell).warnings)
    assert not any("changed while" in w for w in check_transfer(cell_of(3).observations, cell).warnings)
