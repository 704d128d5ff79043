"""The page and the recording of a diagnosis of motion say what its JSON says; the rms of the drawn channels is that of the fit."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_diagnose_trajectories import recording

from mbcacq.cli.app import app
from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories
from mbcacq.diagnosis.motion.result import ErrorBeforeAfter, FitOfMotion, MotionDiagnosis
from mbcacq.errors import ConfigError
from mbcacq.quantities import significant
from mbcacq.recording.datasets.trajectory_set import write_trajectory_set
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.viewer import open_viewer
from mbcacq.report.sources.from_motion import STRETCH_S, motion_content
from mbcacq.workflow.diagnosis_result import DiagnosisResult


def soft(**others):
    """A compliant and rubbing arm; A2 lifts a weight, A1 turns it."""
    return recording(1, compliance=4e-6, coulomb=5.0, viscous=2.0, **others)


def rows_of(html):
    """The cells of every row of every table, as text."""
    rows = re.findall(r"<tr>(.*?)</tr>", html, re.DOTALL)
    return [[re.sub("<[^>]+>", "", cell).strip() for cell in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row, re.DOTALL)] for row in rows]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder in which ``mbcacq diagnose MOTION`` left a page, a recording and the JSON."""
    desk = tmp_path_factory.mktemp("desk")
    write_trajectory_set(soft(), desk / "motion")
    files = ["--out", desk / "d.json", "--report", desk / "d.html", "--rrd", desk / "d.rrd"]
    done = CliRunner().invoke(app, ["diagnose", str(desk / "motion"), *map(str, files)])
    assert done.exit_code == 0, done.output
    return desk


@pytest.fixture(scope="module")
def content(made):
    return json.loads((made / "d.json").read_text(encoding="utf-8"))


def test_the_page_holds_the_verdict_and_the_figures_of_every_channel(made, content):
    html = (made / "d.html").read_text(encoding="utf-8")
    headline = {"explained": "Explained", "partly_explained": "Partly explained", "cannot_tell": "Cannot tell"}[content["verdict"]]
    assert f"<strong>{headline}</strong>" in html
    rows = rows_of(html)
    assert len(content["fit"]["channels"]) == 4  # torque and joint side of two axes
    for c in content["fit"]["channels"]:
        held_out, fit = c["held_out"], c["train"]
        figures = [held_out["before_rms"], held_out["after_rms"], held_out["before_chi2_dof"], held_out["after_chi2_dof"]]
        figures += [fit["before_rms"], fit["after_rms"], c["noise_floor"]]
        assert [c["at"], *map(significant, figures)] in rows
        assert f'id="figure-motion_{c["channel"]}_{c["at"]}"' in html


def test_the_page_holds_the_parameters_of_every_effect(made, content):
    rows = rows_of((made / "d.html").read_text(encoding="utf-8"))
    names = {row[0]: row for row in rows if len(row) == 4}
    assert {name for e in content["effects"] for name in e["parameters"]} >= {"A2.compliance_rad_per_Nm", "A1.viscous_Nms_per_rad"}
    assert names["A2 compliance"][3] == "µrad/(N·m)"
    assert float(names["A2 compliance"][1]) == pytest.approx(
        4.0, abs=2 * float(names["A2 compliance"][2])
    )  # what was injected, U with k = 2
    assert names["A1 viscous"][3] == "N·m·s/rad"


def test_the_recording_can_be_opened_and_its_residuals_are_those_of_the_fit(made, content):
    curves = Recording(made / "d.rrd").scalars("diagnosis/motion/channels/**")
    channels = content["fit"]["channels"]
    assert len(curves) == 5 * len(channels)  # measured, two models, two residuals
    for c in channels:
        entity = f"/diagnosis/motion/channels/0/{c['channel']}/{c['at']}"
        measured, before, after = (np.array(curves[f"{entity}/{name}"]) for name in ("measured", "model/before", "model/after"))
        for model, when in ((before, "before"), (after, "after")):
            assert np.sqrt(np.nanmean((measured - model) ** 2)) == pytest.approx(c["train"][f"{when}_rms"], rel=1e-6)
            residual = np.array(curves[f"{entity}/residual/{when}"])
            np.testing.assert_allclose(residual, measured - model)


def test_the_recording_says_the_verdict(made):
    (row,) = Recording(made / "d.rrd").rows("diagnosis/motion/text")
    text = str(row)
    assert "xplained" in text
    assert "Friction at A1" in text


def test_after_a_look_a_recording_is_calibrated_and_a_diagnosis_is_not(made, monkeypatch):
    monkeypatch.setattr(open_viewer, "view", lambda sources, opening: opening())
    recording = Path(__file__).parents[1] / "recording" / "three_poses.rrd"
    said = {name: CliRunner().invoke(app, ["view", str(name)]).stderr for name in (recording, made / "d.rrd")}
    assert f"next: calibrate with it: mbcacq calibrate {recording}" in said[recording]
    assert "next:" not in said[made / "d.rrd"]


def test_a_diagnosis_that_was_read_has_no_curves_and_says_so(made, tmp_path):
    read = DiagnosisResult.from_json((made / "d.json").read_text(encoding="utf-8"))
    for write in (read.write_html, read.write_rrd):
        with pytest.raises(ConfigError, match="diagnose the recording again"):
            write(tmp_path / "file")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def found():
    return diagnose_trajectories([soft()], cross_validation=False)


def test_what_is_drawn_is_the_json_left_as_it_was(found):
    assert "plot_data" not in found.to_json()
    assert MotionDiagnosis.from_json(found.to_json()) == replace(found, plot_data=None)


def test_a_fit_that_leaves_more_than_held_out_data_is_explained(found):
    """What is selected without a part may be another set of effects than what is selected on all."""
    two = [c for c in found.fit.channels if c.channel == "tau"]
    fit, held_out = (ErrorBeforeAfter(1390.0, after, 1.0, 1.0) for after in (881.0, 416.0))
    changed = [replace(two[0], train=fit, held_out=held_out), replace(two[1], train=held_out, held_out=fit)]
    rows = motion_content(replace(found, fit=FitOfMotion.of(changed, ""))).kinds[0].rows
    assert rows[0].remark.startswith("the fit leaves more than held-out data do")
    assert rows[1].remark == ""


def test_of_a_long_recording_the_stretch_with_the_largest_difference_is_drawn(found):
    """Ten times as large for 5 s at 100 s of 200."""
    step = 0.01
    time = np.arange(0, 200, step)
    size = np.where((time >= 100) & (time < 105), 10.0, 1.0)
    one = replace(found.series.channels[0], time_s=time, measured=size, before=np.zeros_like(time), after=np.zeros_like(time))
    alone = replace(found, fit=FitOfMotion.of(found.fit.channels[:1], ""), plot_data=replace(found.series, channels=(one,)))
    (drawn,) = motion_content(alone).kinds[0].series
    assert drawn.time_s[0] <= 100.0 < 105.0 <= drawn.time_s[-1] + 2 * step
    assert drawn.time_s[-1] - drawn.time_s[0] <= STRETCH_S


def test_a_joint_whose_model_is_refused_is_drawn_without_it(found, monkeypatch):
    from mbcacq.diagnosis.motion import diagnose

    def refuse(fits, channels, *others):
        return real(fits, [replace(c, refused_rms=1.0) if c.at == "A2" else c for c in channels], *others)

    real = diagnose.motion_series
    monkeypatch.setattr(diagnose, "motion_series", refuse)
    for c in diagnose_trajectories([soft()], cross_validation=False).series.channels:
        same = np.array_equal(c.before, c.after, equal_nan=True)
        assert same == (c.at == "A2")


def test_stretches_of_one_recording_are_one_curve_with_a_gap(found, tmp_path):
    """A run's moves have one name and one clock."""
    series = found.series
    late = [replace(c, time_s=c.time_s + 100.0) for c in series.channels]
    both = replace(found, plot_data=replace(series, channels=(*series.channels, *late)))
    path = DiagnosisResult(motion=both).write_rrd(tmp_path / "d.rrd")
    curves = Recording(path).scalars("diagnosis/motion/channels/**")
    assert len(curves) == 5 * len(series.channels)
    first = series.channels[0]
    measured = np.array(curves[f"/diagnosis/motion/channels/0/{first.channel}/{first.at}/measured"])
    np.testing.assert_allclose(measured[: len(first.time_s)], first.measured)
    assert np.isnan(measured[len(first.time_s)])
