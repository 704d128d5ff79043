"""A run against a fake cell says so in journal, log, recording and on the terminal."""

from dataclasses import replace

import synthetic

from mbcacq.cli.progress import RunProgress
from mbcacq.model.cell import SIMULATED
from mbcacq.recording import load_observations, load_whole_trajectories
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.recording.run_folder.journal import Journal, read_journal, read_log


def recorded(folder, simulated):
    first, *rest = synthetic.run()
    yaml = synthetic.CELL.replace("robot:  ", "simulated: true\nrobot:  ") if simulated else synthetic.CELL
    with Recorder(folder) as recorder, Journal(folder) as journal:
        for event in [replace(first, cell_yaml=yaml, simulated=simulated), *rest]:
            recorder(event)
            journal(event)
    return folder


def test_the_journal_and_the_log_say_it(tmp_path):
    assert read_journal(recorded(tmp_path / "a", True))[0]["simulated"] is True
    assert any(entry["text"] == SIMULATED for entry in read_log(tmp_path / "a"))
    assert "simulated" not in read_journal(recorded(tmp_path / "b", False))[0]


def test_the_recording_says_it(tmp_path):
    recording = Recording(recorded(tmp_path / "a", True) / "run.rrd")
    assert recording.about()["simulated"]
    assert any(SIMULATED in row.get("text", [""])[0] for row in recording.rows("log"))
    assert load_observations(tmp_path / "a").cell.simulated
    assert load_whole_trajectories(tmp_path / "a")[0].simulated
    assert "simulated" not in Recording(recorded(tmp_path / "b", False) / "run.rrd").about()


def test_the_terminal_shows_a_banner(capsys):
    progress = RunProgress()
    first, *_ = synthetic.run()
    progress(replace(first, simulated=True))
    assert SIMULATED in capsys.readouterr().err
