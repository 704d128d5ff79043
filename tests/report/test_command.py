"""``mbcacq report`` on data of every kind, and its sections on devices and diagnosis."""

import json
import shutil

import numpy as np
import pytest
from click.testing import CliRunner
from made_up import devices, diagnosis, pictures
from result_page import Page, make_observations, make_result
from run_events import pose_done

from mbcacq.acquisition import events
from mbcacq.cli.app import app
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.errors import ConfigError
from mbcacq.recording.run_folder.journal import Journal
from mbcacq.report.sources.from_diagnosis import diagnosis_content
from mbcacq.report.sources.run_folder import read_run_info
from mbcacq.report.write import report_from_result, write_diagnosis_page


@pytest.fixture(scope="module")
def a_set(tmp_path_factory):
    """A small recording of a known cell, as an observation set."""
    from dataclasses import replace

    from mbcacq.recording.datasets.observation_set import write_observation_set

    obs = make_observations()
    rng = np.random.default_rng(2)
    P, state = 24, rng.uniform(-1.2, 1.2, (24, 6))
    from mbcacq.geometry import se3
    from mbcacq.model.cell import Artefact, Cell, Station

    balls = np.array([[0.0, 0, 0], [40, 0, 5], [0, 40, -5], [35, 35, 12]])
    artefact = Artefact("mbc", "MBC", (1, 2, 3, 4), balls, np.full(4, 12.0))
    places = np.array([[600.0, 0, 100], [500, 300, -100], [700, -200, 300]])
    cell = Cell(
        obs.cell.robot,
        se3.transform(np.diag([1.0, -1, -1]), np.array([0, 0, 260.0])),
        (artefact,),
        tuple(Station(f"s{i}", "mbc") for i in range(3)),
    )
    station = np.arange(P) % 3
    T = cell.robot.chain.flange(state) @ cell.T_flange_scanner
    points = se3.apply(se3.inverse(T)[:, None], (balls[None] + places[station][:, None]).reshape(P, -1, 3))
    xyz = (points + rng.normal(0, 0.005, points.shape)).reshape(-1, 3)
    made = replace(
        obs,
        cell=cell,
        pose_id=np.arange(P),
        station=station,
        q=state,
        pose=np.repeat(np.arange(P), 4),
        ball=np.tile(np.arange(4), P),
        xyz=xyz,
        phase=None,
    )
    folder = tmp_path_factory.mktemp("data") / "set"
    write_observation_set(made, folder)
    return folder


def test_a_report_of_an_observation_set(a_set, tmp_path):
    done = CliRunner().invoke(app, ["report", str(a_set), "--out", str(tmp_path / "set.html"), "--json"], standalone_mode=False)
    assert done.exception is None, done.exception
    said = json.loads(done.stdout)
    page = Page((tmp_path / "set.html").read_text(encoding="utf-8"))
    assert said["bytes"] == (tmp_path / "set.html").stat().st_size
    assert "Calibrated, not verified" in page.words
    assert "Next: Predict poses that are held out" in page.words
    assert "No diagnosis was made of these data" in page.words
    assert "Accuracy map" in page.words


def test_calibrate_and_report_name_the_gaps_of_a_recording(a_set, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(a_set, run)
    with Journal(run) as journal:
        journal(events.RunStarted(0.0, "x", "2026-11-21T10:00:00+00:00", "", "", 25, {}))
        journal(events.Gap(1.0, "cycles", "3 cycles of the controller were lost after pose 4", 4))
        for pose in range(24):
            journal(pose_done(pose, "s0"))
    shown = CliRunner().invoke(app, ["calibrate", str(run)], standalone_mode=False)
    assert shown.exception is None, shown.exception
    said = json.loads(CliRunner().invoke(app, ["calibrate", str(run), "--json"], standalone_mode=False).stdout)["gaps"]
    assert said == ["3 cycles of the controller were lost after pose 4", "1 of 25 planned poses were not measured: 24"]
    assert all(f"About the recording: {gap}" in shown.stdout for gap in said)
    CliRunner().invoke(app, ["report", str(run)], standalone_mode=False, catch_exceptions=False)
    assert f"About the recording: {'; '.join(said)}." in Page((run / "report.html").read_text(encoding="utf-8")).words


def test_a_file_needs_a_path_for_its_report(a_set, tmp_path):
    with pytest.raises(ConfigError, match="--out"):
        CliRunner().invoke(app, ["report", str(a_set / "cell.yaml")], standalone_mode=False, catch_exceptions=False)


def test_the_diagnosis_of_a_run_folder_is_reported(tmp_path):
    (tmp_path / "diagnosis.json").write_text(json.dumps(diagnosis()))
    (tmp_path / "diagnosis-pictures.json").write_text(json.dumps(pictures()))
    info = read_run_info(tmp_path)
    words = Page(
        report_from_result(make_result(), path=tmp_path / "r.html", observations=make_observations(), run_info=info).read_text(
            encoding="utf-8"
        )
    ).words
    assert "Joint compliance at A2" in words
    assert "A2 compliance 2.09 0.18 µrad/(N·m)" in words
    assert "2 100.080 ± 0.042" in words
    assert "held-out data (by station) 14.9 µm (χ²/dof 2.10) 9.7 µm (χ²/dof 1.03)" in words
    assert "0.1%" in words
    assert "Take it into the model: joint compliance at A2" in words
    assert "mbcacq diagnose" in words


def test_damaged_pictures_are_left_out_and_the_text_stays():
    assert diagnosis_content(Diagnosis.from_json(diagnosis()), {"format": "other"}).curves == []
    assert diagnosis_content(Diagnosis.from_json(diagnosis()), {"map": [], "curves": [{"x": 1}], "causes": 3}).headline == "Explained"


def test_a_diagnosis_as_a_page_of_its_own(tmp_path):
    page = Page(write_diagnosis_page(Diagnosis.from_json(diagnosis()), pictures(), tmp_path / "d.html").read_text(encoding="utf-8"))
    assert page.loads == []
    assert "The effects below bring the simulation down to the measured noise" in page.words


def test_timing_and_health_of_devices_are_reported(tmp_path):
    words = Page(
        report_from_result(make_result(), path=tmp_path / "r.html", run_info={"devices": devices()}).read_text(encoding="utf-8")
    ).words
    assert "pose 7 left out: 2 of 8 balls found" in words
    assert "scanner: temperature, °C 40 45 44" in words


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({}, "Put the result to use"),
        ({"verification": None}, "Predict poses that are held out"),
        ({"limit": 0.3}, "Ask why"),
        ({"noise": 3.0}, "Ask why"),
        ({"limit": 0.457}, "Decide with a smaller uncertainty"),
    ],
)
def test_the_one_thing_to_do_next(tmp_path, change, what):
    result = make_result(change.get("limit", 0.5))
    if "verification" in change:
        result["verification"] = None
    if "noise" in change:
        result["noise"]["check_factor"] = [1.0, 1.0, change["noise"]]
    words = Page(report_from_result(result, path=tmp_path / "r.html", observations=make_observations()).read_text(encoding="utf-8")).words
    assert f"Next: {what}" in words


def test_the_largest_recording_makes_a_small_page(tmp_path):
    """Fifteen thousand poses: what is drawn is thinned, the largest are all there."""
    from mbcacq.report.charts.style import MOST, thinned

    size = np.abs(np.random.default_rng(0).normal(size=15_000))
    keep = thinned(size)
    assert len(keep) <= MOST
    assert set(np.argsort(-size)[:100]) <= set(keep.tolist())
