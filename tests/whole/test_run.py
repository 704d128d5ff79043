"""The whole line as a user has it: the command, its exit code, what it leaves behind."""

import json
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
from dry_runs import few_views, plan_file
from typed_command import MBCACQ, ROOT, mbcacq, one_sentence, until


@pytest.mark.parametrize("command", [["schema"], ["drivers", "--json"]])
def test_a_reader_that_has_enough_is_no_error(command):
    process = subprocess.Popen([MBCACQ, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.stderr.read() == b""
    assert process.wait(60) == 0
    process.stderr.close()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the device that is always full is Linux's")
def test_a_full_disk_behind_the_output_is_said_and_is_no_bug():
    with open("/dev/full", "w") as full:
        done = subprocess.run([MBCACQ, "drivers"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=900)
    assert done.returncode == 6
    assert "no space is left" in one_sentence(done)


def test_the_published_plan_ends_below_thirty_micrometres_at_the_bar(finished_run, tmp_path):
    shutil.copytree(finished_run("kuka.yaml").folder, tmp_path / "run")
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert len(result["verification"]["places"]) == 10
    assert result["verification"]["before"]["mean_mm"] > 0.3
    assert result["verification"]["after"]["mean_mm"] < 0.03
    assert result["fit"]["chi2_dof"] == pytest.approx(1.0, abs=0.15)
    for name in ("run.rrd", "result.rrd", "result.json", "report.html"):
        assert (tmp_path / "run" / name).stat().st_size > 10_000
    again = mbcacq("calibrate", tmp_path / "run", "--json")
    same = json.loads(again.stdout)
    assert [p["value"] for p in same["parameters"]] == [p["value"] for p in result["parameters"]]
    report = mbcacq("report", tmp_path / "run")
    assert report.returncode == 0
    assert "calibrating" not in report.stderr  # everything that the page shows stands in result.json
    back = tmp_path / "observations"
    assert mbcacq("export", tmp_path / "run", "--observations", back).returncode == 0
    folder = json.loads(mbcacq("calibrate", back, "--json").stdout)
    assert [p["value"] for p in folder["parameters"]] == [p["value"] for p in result["parameters"]]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 5), (signal.SIGHUP, 5)])
def test_an_interrupted_run_ends_in_order_with_a_complete_recording(tmp_path, number, code):
    run = tmp_path / "run"
    process = subprocess.Popen(
        [MBCACQ, "run", "plans/quick.yaml", "--dry-run", "--out", run],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    journal = run / "journal.jsonl"
    until(lambda: journal.exists() and '"pose_done"' in journal.read_text())
    process.send_signal(number)
    _, text = process.communicate(timeout=900)
    assert process.returncode == code, text
    assert "Traceback" not in text
    assert "leaked" not in text
    from mbcacq.recording import load_observations
    from mbcacq.recording.rrd.reader import Recording

    assert load_observations(run).n_poses >= 1
    assert Recording(run / "run.rrd").about()["exit_status"] == "abort"


def test_broken_yaml(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text("format: mbcacq-plan/1\nname: [unclosed\nrobot: {}\n")
    done = mbcacq("run", path, "--dry-run")
    assert done.returncode == 2
    assert f"{path}:" in one_sentence(done)


def test_unknown_key_names_its_line(tmp_path):
    path = plan_file(tmp_path, lambda p: p["robot"].update(sped=0.5))
    line = next(k for k, text in enumerate(path.read_text().splitlines(), 1) if "sped" in text)
    done = mbcacq("plan", "check", path)
    assert done.returncode == 2
    assert f"{path}:{line}:" in one_sentence(done)
    assert "sped" in done.stderr


def test_unreachable_pose_names_step_and_line(tmp_path):
    path = plan_file(tmp_path, lambda p: p["stations"][0]["pose_in_base"].update(translation_mm=[2600, 0, 150]))
    done = mbcacq("run", path, "--dry-run", "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "translations" in one_sentence(done)
    assert f"{path}:" in done.stderr
    assert not (tmp_path / "run" / "run.rrd").exists()


def test_wrong_artefact_in_view_loses_nothing(tmp_path):
    def change(plan):
        few_views(plan)
        plan["artefacts"].append(str(ROOT / "plans" / "artefacts" / "bar-735.yaml"))
        plan["fake"] = {"mishaps": [{"kind": "wrong_artefact", "station": "p1", "artefact": "bar", "from_arrival": 3}]}

    done = mbcacq("run", plan_file(tmp_path, change), "--dry-run", "--out", tmp_path / "run")
    assert done.returncode == 4, done.stderr
    assert "artefact" in one_sentence(done)
    from mbcacq.recording import load_observations

    assert load_observations(tmp_path / "run").n_poses >= 1


def test_a_scanner_that_is_not_there(tmp_path):
    def change(plan):
        plan["robot"]["options"] = {"bind": "127.0.0.1", "port": 49977, "connect_timeout_s": 1.0}
        plan["scanner"]["options"] = {"address": "127.0.0.1", "control_port": 49978}

    done = mbcacq("run", plan_file(tmp_path, change), "--yes", "--out", tmp_path / "run")
    assert done.returncode == 3
    sentence = one_sentence(done)
    assert "49978" in sentence  # the scanner, and the controller that keeps silent too, in one message
    assert "49977" in sentence
    assert f"; without hardware: mbcacq run {tmp_path}/plan.yaml --dry-run, or start the fake cell in another terminal first: " in sentence
    assert sentence.endswith(f"mbcacq fakes {tmp_path}/plan.yaml")


def test_a_person_who_must_be_asked_and_is_not_there_is_missed_before_anything_is_opened(tmp_path, monkeypatch):
    """Not after the devices were connected: no device, no folder, nothing to resume."""

    def opened(self):
        raise AssertionError("a device was connected")

    monkeypatch.setattr("mbcacq.acquisition.cell_devices.CellDevices.connect", opened)
    done = mbcacq("run", plan_file(tmp_path, lambda plan: None), "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "standard input is not a terminal; run in a terminal, or use --yes" in one_sentence(done)
    assert not (tmp_path / "run").exists()
    assert "next:" not in done.stderr


def test_a_driver_that_cannot_be_imported_leaves_no_folder(tmp_path, monkeypatch):
    from mbcacq.acquisition import cell_devices
    from mbcacq.devices import ConfigError

    made = cell_devices.create

    def create(kind, name, model, options):
        if kind == "scanners":
            raise ConfigError("driver 'acme' (acme:Scanner) cannot be imported: No module named 'acme_sdk'; install what it needs")
        return made(kind, name, model, options)

    monkeypatch.setattr(cell_devices, "create", create)
    done = mbcacq("run", plan_file(tmp_path, lambda plan: None), "--dry-run", "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "acme_sdk" in one_sentence(done)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("keep", [0.3, 0.9])
def test_truncated_recording(finished_run, tmp_path, keep):
    torn = tmp_path / "torn.rrd"
    data = (finished_run("quick.yaml").folder / "run.rrd").read_bytes()
    torn.write_bytes(data[: int(keep * len(data))])
    done = mbcacq("calibrate", torn)
    assert done.returncode in (6, 7), done.stderr
    if done.returncode == 6:
        assert "mbcacq recover" in one_sentence(done)
