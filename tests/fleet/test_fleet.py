"""A fleet: broken recordings are rows, what is done is not repeated, drift and odd arms are found, and a prior is what the arms are."""

import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

sys.path.insert(0, str(Path(__file__).parents[1] / "calibration"))
import cells

import mbcacq
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.estimation.options import ArmPrior, CalibrationOptions
from mbcacq.fleet import cluster
from mbcacq.fleet.arm_prior import learnt, population, read_priors
from mbcacq.fleet.control_chart import arm_types, excess_variance, outliers, weighted_median
from mbcacq.fleet.drift import drifts
from mbcacq.fleet.evaluation import FleetTask, evaluate_recording
from mbcacq.fleet.recordings import FleetRecording, dated, find_recordings, listed
from mbcacq.fleet.row import FleetRow
from mbcacq.fleet.store import FleetStore, read_table, stored_result
from mbcacq.recording.datasets.observation_set import write_observation_set

NAMES = [f"{p}_{i + 1}" for i in range(6) for p in ("theta", "d", "a", "alpha", "beta")]


@pytest.fixture(scope="module")
def cell():
    return cells.scanner_cell(np.random.default_rng(3), stations=4, per_station=6)


@pytest.fixture(scope="module")
def folder(cell, tmp_path_factory):
    """One arm, three recordings: the second has lost its poses."""
    root = tmp_path_factory.mktemp("fleet") / "arm-7"
    for k in range(3):
        obs = cells.measure(cell.observations, cell.truth, np.random.default_rng(k), (0.005, 0.005, 0.009), 8e-6)
        write_observation_set(obs, root / f"2026-0{k + 1}-15")
    (root / "2026-02-15" / "poses.csv").write_text("pose\n")
    return root


def mbcacq_fleet(*arguments):
    command = [Path(sys.executable).parent / "mbcacq", "fleet", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=900, env={**os.environ, "OMP_NUM_THREADS": "1"})


@contextmanager
def running_cluster():
    """Address of the scheduler of a cluster in this process."""
    from dask.distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1", dashboard_address="127.0.0.1:0"
    ) as running:
        yield running.scheduler_address


def test_a_broken_recording_is_a_row_and_nothing_is_done_twice(folder, tmp_path):
    first = mbcacq_fleet(folder, "--out", tmp_path, "--workers", "1", "--json")
    assert first.returncode == 0, first.stderr
    said = json.loads(first.stdout)
    assert said["recordings"] == 3
    assert [Path(one["recording"]).name for one in said["broken"]] == ["2026-02-15"]
    assert "poses.csv" in said["broken"][0]["reason"]
    assert "3 of 3 recordings" in first.stderr

    rows = parquet.read_table(tmp_path / "fleet.parquet").to_pylist()
    assert [row["status"] for row in rows] == ["evaluated", "refused", "evaluated"]
    assert {row["arm"] for row in rows} == {"arm-7"}
    assert rows[0]["time"] == "2026-01-15T00:00:00+00:00"
    assert rows[0]["std.a_2"] > 0
    page = (tmp_path / "fleet.html").read_text()
    assert "2026-02-15" in page
    assert 'id="data-drift_0"' in page

    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "recordings").iterdir()}
    again = mbcacq.evaluate_fleet([folder], tmp_path, progress=lambda *_: pytest.fail("a recording was evaluated again"))
    assert [row.rms_mm for row in again.rows] == [row["rms_mm"] for row in rows]
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "recordings").iterdir()} == written


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL and no groups of processes")
@pytest.mark.parametrize("how", ["kill -9", "Ctrl-C"])
def test_what_was_stored_before_an_end_is_not_repeated(how, folder, tmp_path):
    for k in range(150):  # so many that the end comes amid them on a busy computer too
        shutil.copytree(folder / "2026-01-15", tmp_path / "runs" / f"day-{k:03d}")
    out = tmp_path / "out"
    command = [Path(sys.executable).parent / "mbcacq", "fleet", tmp_path / "runs", "--out", out, "--workers", "2"]
    log = tmp_path / "stderr"
    with log.open("w") as said, subprocess.Popen(command, stdout=said, stderr=said, start_new_session=True) as process:
        end = time.monotonic() + 900
        while len(list(out.glob("recordings/*.json"))) < 3 and process.poll() is None and time.monotonic() < end:
            time.sleep(0.01)
        if how == "Ctrl-C":
            os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to all processes
        else:
            process.kill()
    if how == "Ctrl-C":
        assert process.returncode == 130
        assert log.read_text().strip().splitlines()[-1] == "mbcacq: interrupted"
        assert "Traceback" not in log.read_text()
    stored = {path: path.stat().st_mtime_ns for path in (out / "recordings").glob("*.json")}
    assert len(stored) >= 3
    kept = {Path(json.loads(path.read_text())["row"]["recording"]).name for path in stored}
    waiting = sorted({path.name for path in (tmp_path / "runs").iterdir()} - kept)
    for name in waiting[2:]:  # two are enough to show that the fleet goes on
        shutil.rmtree(tmp_path / "runs" / name)
    with running_cluster() as scheduler:
        mbcacq.evaluate_fleet([tmp_path / "runs"], out, scheduler=scheduler)
    assert {path: path.stat().st_mtime_ns for path in stored} == stored
    assert [row.status for row in read_table(out)] == ["evaluated"] * (len(kept) + len(waiting[:2]))


def test_a_worker_keeps_what_is_done_and_gives_back_what_its_time_does_not_allow(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "BATCH_S", 0.0)
    store, batch = FleetStore(tmp_path, FleetTask()), []
    for one in find_recordings([folder]):
        batch.append((one, store.stamp(one)))
    (done,) = cluster.evaluated_batch(batch, FleetTask(), store)
    assert done.row == store.row(batch[0][0])
    monkeypatch.setattr(cluster, "evaluate_recording", lambda *_: pytest.fail("a recording was evaluated again"))
    assert cluster.evaluated_batch(batch, FleetTask(), store) == [done]


def test_the_recording_at_which_a_worker_ends_fails_and_its_neighbours_do_not(folder, tmp_path):
    """The first of three is stored, at the second the worker ends, the third has not been begun."""
    store = FleetStore(tmp_path, FleetTask())
    batch = [(one, store.stamp(one)) for one in find_recordings([folder])]
    cluster.evaluated_batch(batch[:1], FleetTask(), store)
    ended = cluster._ended(batch, store, type("KilledWorker", (Exception,), {})())
    assert [one.row.status for one in ended] == ["evaluated", "failed"]
    assert ended[1].row.recording == batch[1][0].path
    assert "was ended" in ended[1].row.reason
    with pytest.raises(RecordingError, match="full"):
        cluster._ended(batch, store, RecordingError("the disk is full"))


def test_a_cluster_that_runs_already_does_the_same(folder, tmp_path):
    with running_cluster() as scheduler:
        found = mbcacq.evaluate_fleet([folder], tmp_path, scheduler=scheduler)
    assert [row.status for row in found.rows] == ["evaluated", "refused", "evaluated"]
    store = FleetStore(tmp_path, FleetTask())
    assert all(store.row(one) is not None for one in find_recordings([folder]))


def test_a_recording_counts_as_done_until_it_or_the_task_changes(folder, tmp_path):
    (one, *_) = find_recordings([folder])
    store = FleetStore(tmp_path, FleetTask())
    store.keep(one, stored_result(*evaluate_recording(one, FleetTask()), store.stamp(one)))
    assert store.row(one).status == "evaluated"
    assert FleetStore(tmp_path, FleetTask(diagnose=True)).row(one) is None
    text = store.path(one).read_text()
    store.path(one).write_text(text.replace('"poses": 1', '"poses": 2', 1) if '"poses": 1' in text else text.replace("0.1", "0.2", 1))
    assert store.row(one) is None  # a changed digit
    assert store.damaged == [store.path(one)]
    store.path(one).write_text(text)
    file = Path(one.path) / "centres.csv"
    os.utime(file, ns=(0, file.stat().st_mtime_ns + 1_000_000_000))
    assert store.row(one) is None
    store.path(one).write_text('{"format": "mbcacq-fleet-rec')  # torn
    assert store.row(one) is None


def test_what_fails_for_no_fault_of_its_own_is_tried_again(folder, tmp_path, monkeypatch):
    (one, *_) = find_recordings([folder])
    monkeypatch.setattr("mbcacq.fleet.evaluation.load_observations", lambda path: (_ for _ in ()).throw(MemoryError("full")))
    row, content = evaluate_recording(one, FleetTask())
    assert row.status == "failed"
    assert "MemoryError" in row.reason
    store = FleetStore(tmp_path, FleetTask())
    store.keep(one, stored_result(row, content, store.stamp(one)))
    assert store.row(one) is None


def test_tasks_and_recordings_pickle(cell):
    task = FleetTask(options=CalibrationOptions(hold=("d_2",)))
    assert pickle.loads(pickle.dumps(task)) == task
    one = FleetRecording("/somewhere/run", "arm", "2026-01-01T00:00:00+00:00")
    assert pickle.loads(pickle.dumps(one)) == one
    assert np.array_equal(pickle.loads(pickle.dumps(cell.observations)).xyz, cell.observations.xyz)


@pytest.mark.parametrize(
    ("name", "time"),
    [("2026-03-01", "2026-03-01T00:00:00+00:00"), ("run_20260301T0830", "2026-03-01T08:30:00+00:00"), ("2026-13-45", ""), ("quick", "")],
)
def test_a_date_in_a_name_is_the_time(name, time):
    assert dated(name) == time


def test_a_table_names_arm_and_time_and_its_faults_have_a_line(folder, tmp_path):
    table = tmp_path / "arms.csv"
    table.write_text(f"recording,arm,time\n{folder / '2026-01-15'},left,2025-05-05\n")
    (one,) = find_recordings([table])
    assert (one.arm, one.time) == ("left", "2025-05-05T00:00:00+00:00")
    table.write_text(f"recording,arm,time\n{folder / '2026-01-15'},left,yesterday\n")
    with pytest.raises(ConfigError, match="arms.csv:2: column time: 'yesterday' is no time"):
        find_recordings([table])
    with pytest.raises(ConfigError, match="given twice"):
        find_recordings([folder, folder / "2026-01-15"])


def made_rows(arms, each, rng, drift=0.0, odd=0.0):
    """Rows of arms whose theta_2 is known to 1e-5 rad; the first drifts, the last is unlike the others."""
    rows = []
    for a in range(arms):
        own = rng.normal() * 1e-4 + (odd if a == arms - 1 else 0.0)
        for k in range(each):
            std = 1e-5 * rng.uniform(0.5, 2)
            value = own + std * rng.normal() + (drift * k / each if a == 0 else 0.0)
            rows.append(
                FleetRow(
                    recording=f"/{a}/{k}", arm=f"arm-{a:02d}", time=f"2026-01-{k + 1:02d}", status="evaluated", robot="R",
                    nominal=(0.0,) * 30, estimates={"theta_2": (value, std)}, names=("theta_2",), covariance=(std**2,),
                )
            )  # fmt: skip
    return rows


def test_a_drifting_arm_and_an_odd_arm_are_named_and_no_other():
    found = outliers(arm_types(made_rows(20, 8, np.random.default_rng(1), drift=4e-4, odd=3e-3)))
    assert {o.arm for o in found if o.recording is not None} == {"arm-00"}
    assert {o.arm for o in found if o.recording is None and not o.drift} == {"arm-19"}
    (drifting,) = (o for o in found if o.drift)
    assert (drifting.arm, drifting.name) == ("arm-00", "theta_2")
    assert drifting.value == pytest.approx(4e-4 * 7 / 8, rel=0.2)


def test_a_drift_that_no_parameter_shows_by_itself_is_found_by_all_together():
    """theta_2 and a_1 are known to 0.1 only, but one combination of them to 0.001."""
    rng, covariance = np.random.default_rng(4), np.array([[1e-2, 0.99995e-2], [0.99995e-2, 1e-2]])
    root = np.linalg.cholesky(covariance)
    rows = []
    for arm in range(8):
        for k in range(6):
            value = root @ rng.normal(size=2) + (np.array([0.02 * k / 5, 0.0]) if arm == 2 else 0.0)
            rows.append(
                FleetRow(
                    recording="", arm=f"arm-{arm}", names=("theta_2", "a_1"), covariance=tuple(covariance.reshape(-1)),
                    estimates={"theta_2": (value[0], 0.1), "a_1": (value[1], 0.1)},
                )
            )  # fmt: skip
    (found,) = drifts(rows)
    assert found.arm == "arm-2"
    assert abs(found.change) == pytest.approx(0.02, rel=0.3)


def test_false_alarms_are_as_rare_as_the_limits_say():
    rng = np.random.default_rng(2)
    outside = recordings = drifting = 0
    for _ in range(40):
        (kind,) = arm_types(made_rows(12, 6, rng))
        outside, recordings = outside + int(kind.charts[0].outside.sum()), recordings + len(kind.rows)
        drifting += len(drifts(kind.rows))
    assert outside <= 3 * 0.0027 * recordings
    assert drifting <= 3 * 0.0027 * 40 * 12


def test_excess_variance_is_what_the_stated_one_lacks():
    rng = np.random.default_rng(3)
    stated = rng.uniform(0.5, 2, 4000) ** 2
    assert excess_variance(rng.normal(size=4000) * np.sqrt(stated + 9.0), stated) == pytest.approx(9.0, rel=0.08)
    assert excess_variance(rng.normal(size=4000) * np.sqrt(0.5 * stated), stated) == 0.0
    assert np.isnan(excess_variance(np.ones(2), np.ones(2)))
    assert weighted_median(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 5.0])) == 2.0


def test_the_spread_of_arms_is_told_from_the_uncertainty_of_their_calibrations():
    rng = np.random.default_rng(4)
    count, mean, tau = 4000, np.array([1.0, -2.0]), np.array([0.5, 3.0])
    C = np.array([[1.0, 0.9], [0.9, 2.0]])
    arms = mean + tau * rng.normal(size=(count, 2))
    value = arms + rng.multivariate_normal(np.zeros(2), C, size=count)
    information = np.tile(np.linalg.inv(C), (count, 1, 1))
    found, sigma = population(value, information)
    np.testing.assert_allclose(found, mean, atol=0.2)
    np.testing.assert_allclose(sigma, tau, rtol=0.2)


def test_a_parameter_that_few_arms_know_has_no_prior():
    rows = made_rows(4, 2, np.random.default_rng(5))
    (kind,) = arm_types(rows)
    assert learnt(kind) is None
    (kind,) = arm_types(made_rows(9, 2, np.random.default_rng(5)))
    prior = learnt(kind)
    assert np.isfinite(prior.sigma[1, 0])
    assert np.isinf(np.delete(prior.sigma.reshape(-1), 5)).all()


def test_a_prior_about_the_truth_improves_a_short_recording_and_counts_in_its_uncertainty(cell):
    chain = cell.observations.cell.robot.chain
    sigma = np.tile([1e-5, 0.005, 0.005, 5e-6, 5e-6], (6, 1))
    prior = ArmPrior("test arm", chain.rows, cell.errors, sigma, 9)
    short = cell.observations.select(cell.observations.station < 2)
    free = mbcacq.calibrate(short, CalibrationOptions(refuse=False))
    known = mbcacq.calibrate(short, CalibrationOptions(refuse=False, priors=(prior,)))
    off = [np.sqrt(np.mean((fit.errors - cell.errors)[:, 2] ** 2)) for fit in (free, known)]
    assert off[1] < 0.2 * off[0]
    std = {p.name: p.std for p in known.parameters}
    assert std["a_2"] < 0.0051
    assert next(p for p in known.parameters if p.name == "a_2").status == "prior"
    other = replace(prior, nominal=chain.rows + 1.0)
    with pytest.raises(ConfigError, match="knows no arm with the nominal geometry of 'test arm'"):
        mbcacq.calibrate(short, CalibrationOptions(priors=(other,)))


def test_a_table_that_is_no_text_is_refused_in_words(tmp_path):
    table = tmp_path / "arms.csv"
    table.write_bytes(b"recording,arm\n\xff,1\n")
    with pytest.raises(ConfigError, match=r"arms\.csv:2: not UTF-8 text"):
        listed(table)


def test_a_prior_is_read_from_the_table_of_a_fleet(tmp_path):
    rows = made_rows(9, 2, np.random.default_rng(5))
    for row in rows:
        row.out_of_control = ()
    FleetStore(tmp_path, FleetTask()).write(rows, "")
    (prior,) = read_priors(tmp_path)
    assert prior.arms == 9
    assert len(read_table(tmp_path / "fleet.parquet")) == 18
    (tmp_path / "fleet.html").write_text("x")
    with pytest.raises(ConfigError, match=r"fleet.html cannot be read as the table of a fleet"):
        read_priors(tmp_path / "fleet.html")
