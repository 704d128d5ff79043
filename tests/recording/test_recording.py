"""What the recorder wrote, the reader gives back bit for bit."""

from __future__ import annotations

import dataclasses
import json
import os
import socket
import subprocess

import numpy as np
import psutil
import pytest
import synthetic
from mbcacq_fakes.cell.ports import free_port

from mbcacq.acquisition import events
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.recording import load_observations
from mbcacq.recording.datasets.observation_set import write_observation_set
from mbcacq.recording.rrd import layout, scan_export
from mbcacq.recording.rrd.reader import Recording, open_recordings, opened_once
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.recording.run_folder.journal import Journal, read_journal
from mbcacq.recording.run_folder.progress import poses_done
from mbcacq.workflow.export import export


def of(kind, stream):
    return [event for event in stream if isinstance(event, kind)]


def record(folder, stream, **options):
    with Recorder(folder, **options) as recorder:
        for event in stream:
            recorder(event)


def test_observations_are_those_of_the_run(a_run):
    done = of(events.PoseDone, synthetic.run())
    for obs in (load_observations(a_run), load_observations(a_run / "run.rrd")):
        assert obs.pose_id.tolist() == [0, 1, 2, 3]
        np.testing.assert_array_equal(obs.q, [e.q for e in done])
        np.testing.assert_array_equal(obs.direction, [e.direction for e in done])
        np.testing.assert_array_equal(obs.time_s, [e.robot_time_s for e in done])
        np.testing.assert_array_equal(obs.xyz, np.concatenate([e.xyz for e in done]))
        np.testing.assert_array_equal(obs.rms_mm, np.concatenate([e.rms_mm for e in done]))
        np.testing.assert_array_equal(obs.n_points, np.concatenate([e.n_points for e in done]))
        np.testing.assert_array_equal(np.array(obs.cell.ball_ids)[obs.ball], np.concatenate([e.ball for e in done]))
        np.testing.assert_array_equal(obs.temperatures["air_C"], [e.sensors["air_C"] for e in done])
        assert [obs.cell.stations[s].id for s in obs.station] == [e.station for e in done]
        assert obs.phase.tolist() == [e.phase for e in done]
        assert obs.extra["poses.i3_percent"].astype(float).tolist() == [e.current[2] for e in done]
        assert obs.cell_yaml == synthetic.CELL


def test_a_recording_becomes_an_observation_set_and_loses_nothing(a_run, tmp_path):
    obs = load_observations(a_run)
    write_observation_set(obs, tmp_path / "set")
    back = load_observations(tmp_path / "set")
    for field in dataclasses.fields(obs):
        value = getattr(obs, field.name)
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(back, field.name), value, err_msg=field.name)
    assert {k: v.tolist() for k, v in back.extra.items()} == {k: v.tolist() for k, v in obs.extra.items()}


def test_every_cycle_comes_back(a_run):
    sent = [event.cycles.columns for event in of(events.CyclesReceived, synthetic.run())]
    back = Recording(a_run / "run.rrd").cycles()
    assert set(back.columns) == set(sent[0])
    for name, values in back.columns.items():
        expected = np.concatenate([columns[name] for columns in sent])
        assert values.dtype == expected.dtype
        np.testing.assert_array_equal(values, expected)


def test_every_scan_comes_back(a_run):
    taken = of(events.ScanTaken, synthetic.run())
    found = list(Recording(a_run / "run.rrd").scans())
    assert [(f.pose, f.exposure) for f in found] == [(t.pose, t.exposure) for t in taken]
    for back, event in zip(found, taken, strict=True):
        assert back.scan.points.dtype == np.float32
        np.testing.assert_array_equal(back.scan.points, event.scan.points)
        np.testing.assert_array_equal(back.scan.intensity, event.scan.intensity)
        np.testing.assert_array_equal(back.scan.pixel, event.scan.pixel)
        assert (back.scan.shape, back.scan.frame, back.scan.time_s) == (event.scan.shape, event.scan.frame, event.scan.time_s)
        assert back.scan.measurements == {"width": 1.25}


def test_a_scan_without_intensity_and_a_pose_without_current_come_back(tmp_path):
    rng = np.random.default_rng(3)
    stream = list(synthetic.run())
    bare = dataclasses.replace(synthetic.scan(rng), intensity=None, pixel=None, measurements={})
    stream = [dataclasses.replace(e, scan=bare) if isinstance(e, events.ScanTaken) else e for e in stream]
    stream = [dataclasses.replace(e, current=None, sensors={}) if isinstance(e, events.PoseDone) else e for e in stream]
    record(tmp_path, stream)
    scan = next(Recording(tmp_path / "run.rrd").scans()).scan
    assert scan.intensity is None
    assert scan.pixel is None
    assert scan.measurements == {}
    assert load_observations(tmp_path).temperatures == {}


def test_the_run_itself_is_in_it(a_run):
    recording = Recording(a_run / "run.rrd")
    assert recording.text(layout.PLAN) == synthetic.PLAN
    assert recording.text(layout.CELL) == synthetic.CELL
    about = recording.about()
    assert (about["name"], about["started"], about["n_poses"]) == ("made", "2026-01-02T03:04:05+00:00", 4)
    assert (about["exit_status"], about["reason"]) == ("success", "all poses measured")
    assert dict(zip(about["versions_names"], about["versions_values"], strict=True)) == {"mbcacq": "0", "numpy": "2"}


def test_entities_stand_where_the_layout_says(a_run):
    from rerun.chunk import RrdReader

    found = {chunk.entity_path.lstrip("/") for chunk in RrdReader(a_run / "run.rrd").stream()}
    names = (
        "RUN PLAN CELL STATE STEP STATION LOG CYCLES JOINTS FOLLOWING CURRENT SCAN EXPOSURE OBSERVATION BALLS_FOUND FIT_RMS SCATTER SCANNER"
    )
    assert {getattr(layout, name) for name in names.split()} <= found
    assert {layout.link(1), layout.link(6), "world/stations/far", "health/scanner/temperature_C"} <= found
    states = [row["state"][0] for row in Recording(a_run / "run.rrd").rows(layout.STATE) if "state" in row]
    assert states == [event.state for event in of(events.StateChanged, synthetic.run())]


def test_rerun_itself_finds_no_fault(a_run):
    from mbcacq.recording.rrd import rerun_program

    assert rerun_program.run(["rrd", "verify", str(a_run / "run.rrd")]).returncode == 0


def test_the_journal_lists_the_poses(a_run):
    entries = read_journal(a_run)
    assert [e["event"] for e in entries] == ["run_started", *["pose_done"] * 4, "run_stopped"]
    assert [e["pose"] for e in entries if e["event"] == "pose_done"] == [0, 1, 2, 3]
    assert poses_done(a_run) == {0, 1, 2, 3}
    log = [json.loads(line) for line in (a_run / "log.jsonl").read_text().splitlines()]
    assert {"info"} == {entry["level"] for entry in log}
    assert any(entry["text"] == "robot: made up" for entry in log)


def test_a_pose_in_the_journal_alone_is_not_done(a_run):
    """After a power cut the journal may know more than the recording."""
    with (a_run / "journal.jsonl").open("a") as file:
        file.write('{"time_s": 9, "event": "pose_done", "pose": 4}\n{"time_s": 9.1, "event": "pose_do')
    assert poses_done(a_run) == {0, 1, 2, 3}


def test_a_journal_goes_on_after_a_torn_line(tmp_path):
    (tmp_path / "journal.jsonl").write_text('{"event": "pose_done", "pose": 0}\n{"event": "pose_d')
    with Journal(tmp_path) as journal:
        journal(synthetic.start())
    assert [e["event"] for e in read_journal(tmp_path)] == ["pose_done", "run_started"]


def test_a_resumed_run_is_one_run(tmp_path):
    stream = list(synthetic.run(n_poses=4))
    cut = next(i for i, e in enumerate(stream) if isinstance(e, events.PoseReached) and e.pose == 2)
    with Recorder(tmp_path) as first, Journal(tmp_path) as journal:
        for event in stream[:cut]:
            first(event)
            journal(event)
    assert poses_done(tmp_path) == {0, 1}
    later = dataclasses.replace(synthetic.start(), started="2026-01-02T04:04:05+00:00")  # an hour after, the controller restarted
    rng = np.random.default_rng(9)
    again = [later, *(event for k in (1, 2, 3) for event in synthetic.pose(rng, k, 1.0 + k))]
    with Recorder(tmp_path, part=1) as second:
        assert second.recording_id == first.recording_id
        for event in again:
            second(event)
    obs = load_observations(tmp_path)
    assert obs.pose_id.tolist() == [0, 1, 2, 3]
    done = of(events.PoseDone, stream[:cut])[:1] + of(events.PoseDone, again)  # pose 1 was measured twice; the later one counts
    np.testing.assert_array_equal(obs.q, [e.q for e in done])
    assert np.all(np.diff(obs.time_s) > 0)
    assert obs.time_s[1] - obs.time_s[0] == pytest.approx(3600.0, abs=5.0)


def test_a_controller_that_starts_anew_at_once_does_not_turn_time_back(tmp_path):
    """In a dry run the controller's clock runs ahead of the computer's, and starts again when the run is resumed."""
    rng = np.random.default_rng(0)
    with Recorder(tmp_path) as first:
        first(synthetic.start())
        for number in range(2):
            for event in synthetic.pose(rng, number, 1.0 + number):
                first(dataclasses.replace(event, robot_time_s=1000.0 + 50 * number) if isinstance(event, events.PoseDone) else event)
    with Recorder(tmp_path, part=1) as second:
        second(dataclasses.replace(synthetic.start(), started="2026-01-02T03:04:25+00:00"))  # 20 s after the start of the first
        for number in (2, 3):
            for event in synthetic.pose(rng, number, 1.0 + number - 2):
                second(dataclasses.replace(event, robot_time_s=1000.0 + 50 * (number - 2)) if isinstance(event, events.PoseDone) else event)
    assert load_observations(tmp_path).time_s.tolist() == pytest.approx([1000.0, 1050.0, 1069.0, 1119.0])


@pytest.mark.parametrize(("restarted", "seen"), [(False, [1000.0, 1050.0, 1100.0, 1150.0]), (True, [1000.0, 1050.0, 1050.0, 1100.0])])
def test_a_computer_whose_clock_is_set_back_between_two_parts_does_not_turn_time_back(tmp_path, restarted, seen):
    """What the controller's clock says counts; where that began anew too, the pause is not known, and the order stays."""
    rng = np.random.default_rng(0)
    for part, started in enumerate(("2026-01-02T03:04:05+00:00", "2026-01-02T01:04:05+00:00")):
        with Recorder(tmp_path, part=part) as recorder:
            recorder(dataclasses.replace(synthetic.start(), started=started))
            for number in (2 * part, 2 * part + 1):
                at = 1000.0 + 50 * number - (100.0 if restarted and part else 0.0)
                for event in synthetic.pose(rng, number, 1.0 + number):
                    recorder(dataclasses.replace(event, robot_time_s=at) if isinstance(event, events.PoseDone) else event)
    obs = load_observations(tmp_path)
    assert obs.pose_id.tolist() == [0, 1, 2, 3]
    assert obs.time_s.tolist() == pytest.approx(seen)


def test_a_recording_is_never_overwritten(a_run):
    before = (a_run / "run.rrd").read_bytes()
    with pytest.raises(RecordingError, match=r"run\.rrd exists already"):
        Recorder(a_run)
    assert (a_run / "run.rrd").read_bytes() == before


def test_what_is_no_recording_is_refused(tmp_path):
    for content in (b"", b"RRF2", b"hello world, this is no recording" * 10):
        (tmp_path / "x.rrd").write_bytes(content)
        with pytest.raises(RecordingError):
            load_observations(tmp_path / "x.rrd")
    with pytest.raises(ConfigError, match="does not exist"):
        Recording(tmp_path / "absent.rrd")


def test_a_run_without_a_finished_pose_says_so(tmp_path):
    record(tmp_path, list(synthetic.run())[:8])
    with pytest.raises(RecordingError, match="no finished pose"):
        load_observations(tmp_path)


def test_a_fault_in_an_event_keeps_what_came_before(tmp_path):
    stream = list(synthetic.run())
    cut = next(i for i, e in enumerate(stream) if isinstance(e, events.PoseReached) and e.pose == 2)
    recorder = Recorder(tmp_path)
    for event in stream[:cut]:
        recorder(event)
    with pytest.raises(RecordingError, match="what came before is kept"):
        recorder(events.HealthReceived(9.0, "scanner", {"temperature": "warm"}))
    recorder.close()
    assert load_observations(tmp_path).pose_id.tolist() == [0, 1]


def test_live_serves_this_computer_only(tmp_path):
    port = free_port()
    with Recorder(tmp_path, live=True, port=port) as recorder:
        for event in synthetic.run():
            recorder(event)
        with socket.create_connection(("127.0.0.1", port), timeout=5.0):
            pass
        listening = {
            c.laddr.ip for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN and c.laddr.port == port
        }
        assert listening == {"127.0.0.1"}
        assert f"127.0.0.1:{port}" in recorder.live_url
    assert load_observations(tmp_path).n_poses == 4


def test_a_taken_port_does_not_end_a_live_run(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as other, Recorder(tmp_path, live=True, port=other.getsockname()[1]) as recorder:
        assert str(other.getsockname()[1]) not in recorder.live_url
        for event in synthetic.run():
            recorder(event)
    assert load_observations(tmp_path).n_poses == 4


def test_without_live_nothing_listens(tmp_path):
    before = {c.laddr for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN}
    with Recorder(tmp_path) as recorder:
        for event in synthetic.run():
            recorder(event)
        after = {c.laddr for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN}
    assert after == before


def test_the_result_is_written_next_to_the_run(a_run):
    from mbcacq.estimation.forward_model import CellState
    from mbcacq.recording.rrd.result_recording import log_result

    obs = load_observations(a_run)
    place = np.eye(4)
    place[:3, 3] = [300.0, 0.0, 100.0]
    state = CellState(obs.cell.robot.chain, obs.cell.T_flange_scanner, np.stack([place, np.eye(4)]), obs.cell.ball_centres)
    path = log_result(a_run, obs, state)
    result = Recording(path)
    assert result.recording_id == Recording(a_run / "run.rrd").recording_id
    rows = list(result.rows(layout.RESIDUAL_BALL))
    assert [int(row["pose"][0]) for row in rows] == [0, 2]  # station 'far' was not determined
    T = obs.cell.robot.chain.flange(obs.q[:1])[0] @ obs.cell.T_flange_scanner
    expected = obs.xyz[0] - T[:3, :3].T @ (place[:3, 3] + obs.cell.ball_centres[0] - T[:3, 3])  # measured minus where the cell says it is
    np.testing.assert_allclose(rows[0]["after_mm"].reshape(-1, 3)[0], expected, atol=1e-9)
    assert load_observations(a_run).n_poses == 4


@pytest.mark.parametrize("of_a_run", [True, False])
def test_a_diagnosis_shows_both_misfits_and_their_cause(a_run, tmp_path, of_a_run):
    from rerun.chunk import RrdReader

    from mbcacq.recording.rrd.diagnosis_recording import write_diagnosis

    obs = load_observations(a_run)
    before = np.array([[0.003, 0, 0], [0, 0.004, 0], [0, 0, 0.005]])
    centres = {
        "pose": [0, 0, 1],
        "ball": [1, 2, 1],
        "point_mm": np.eye(3).tolist(),
        "before_mm": before.tolist(),
        "after_mm": (before / 10).tolist(),
        "of": 3,
    }
    cause = {"name": "q2", "label": "angle of A2", "unit": "deg", "values": [10.0, 10.0, 30.0]}
    path = write_diagnosis(tmp_path / "errors.rrd", obs, "# Why", {"centres": centres, "causes": [cause]}, a_run if of_a_run else None)
    curves = {}
    for chunk in RrdReader(path).stream().filter(content=f"/{layout.DIAGNOSIS}/**"):
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            curves[chunk.entity_path.rsplit("/", 1)[1]] = np.concatenate(batch.column("Scalars:scalars").to_pylist())
            assert (layout.TIME in batch.schema.names) == of_a_run  # a run's own clock, where there is one
    np.testing.assert_allclose(curves["before"], [1e3 * np.sqrt((0.003**2 + 0.004**2) / 2), 5.0])  # um, rms of a pose
    np.testing.assert_allclose(curves["after"], curves["before"] / 10)
    np.testing.assert_allclose(curves["q2"], [10.0, 30.0])
    if of_a_run:
        assert RrdReader(path).recordings()[0].recording_id == Recording(a_run / "run.rrd").recording_id


def test_subscribers_may_call_from_several_threads(tmp_path):
    import threading

    rng = np.random.default_rng(0)
    batches = [synthetic.cycles(rng, 0.04 * k) for k in range(50)]
    with Recorder(tmp_path) as recorder:
        recorder(synthetic.start())
        sender = threading.Thread(target=lambda: [recorder(events.CyclesReceived(0.04 * k, b)) for k, b in enumerate(batches)])
        sender.start()
        for number in range(3):
            for event in synthetic.pose(np.random.default_rng(number), number, 1.0 + number):
                if not isinstance(event, events.CyclesReceived):
                    recorder(event)
        sender.join()
    assert load_observations(tmp_path).pose_id.tolist() == [0, 1, 2]
    np.testing.assert_array_equal(Recording(tmp_path / "run.rrd").cycles().columns["q"], np.concatenate([b.columns["q"] for b in batches]))


def test_the_command_line_exports_and_recovers(a_run, tmp_path):
    import sys

    def mbcacq(*arguments):
        return subprocess.run(
            [sys.executable, "-c", "from mbcacq.cli import main; main()", *map(str, arguments)], capture_output=True, text=True
        )

    out = mbcacq("export", a_run, "--observations", tmp_path / "set", "--scans", "--trajectory", tmp_path / "time")
    assert out.returncode == 0, out.stderr
    np.testing.assert_array_equal(load_observations(tmp_path / "set").xyz, load_observations(a_run).xyz)
    assert sorted(path.name for path in (tmp_path / "set" / "scans").iterdir()) == ["0.ply", "1.ply", "2.ply", "3.ply"]
    again = mbcacq("export", a_run, "--observations", tmp_path / "set")
    assert again.returncode == 2
    assert "already holds a set" in again.stderr
    recovered = mbcacq("recover", a_run, "--json")
    assert json.loads(recovered.stdout)["recordings"][0] | {"source": 0, "output": 0} == {
        "source": 0,
        "output": 0,
        "damaged": False,
        "poses": 4,
        "cycles": 40,
        "complete": True,
    }


def test_exported_clouds_are_of_the_set_that_they_lie_in(a_run, tmp_path, monkeypatch):
    """The third cloud cannot be read: the set of before stays, its tables and every cloud."""
    export(a_run, observations=tmp_path / "set", scans=True)
    marked = sorted(path for path in (tmp_path / "set").rglob("*.*") if path.is_file())
    for path in marked:
        path.write_bytes(path.read_bytes() + b"old")
    left = [2]

    def content(*cloud):
        left[0] -= 1
        if left[0] < 0:
            raise RecordingError("the cloud is damaged")
        return b"new"

    monkeypatch.setattr(scan_export, "ply_content", content)
    with pytest.raises(RecordingError, match="damaged"):
        export(a_run, observations=tmp_path / "set", scans=True, force=True)
    assert sorted(path for path in (tmp_path / "set").rglob("*.*") if path.is_file()) == marked
    assert all(path.read_bytes().endswith(b"old") for path in marked)


def test_a_recording_is_opened_once_inside_and_anew_when_it_changed(a_run):
    assert open_recordings(a_run)[0] is not open_recordings(a_run)[0]
    with opened_once():
        first = open_recordings(a_run)[0]
        assert open_recordings(a_run)[0] is first
        os.utime(a_run / "run.rrd", ns=(1, 1))
        assert open_recordings(a_run)[0] is not first
