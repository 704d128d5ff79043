"""A dry run, from the command to the files."""

import json

from typed_command import mbcacq

from mbcacq.model.cell import SIMULATED


def test_a_dry_run_is_marked_as_simulated_everywhere(finished_run, tmp_path):
    done = finished_run("quick.yaml")
    run = done.folder
    assert SIMULATED in done.stderr
    assert SIMULATED in done.stdout
    assert json.loads((run / "result.json").read_text())["simulated"] is True
    assert json.loads((run / "journal.jsonl").read_text().splitlines()[0])["simulated"] is True
    assert SIMULATED.capitalize() in (run / "report.html").read_text()
    done = mbcacq("export", run, "--results", tmp_path / "out")
    assert done.returncode == 2
    assert "--simulated-anyway" in done.stderr
    done = mbcacq("export", run, "--observations", tmp_path / "set", "--scans", "--trajectory", tmp_path / "time")
    assert done.returncode == 0, done.stderr
    for name in ("set", "time"):
        assert "simulated: true" in (tmp_path / name / "cell.yaml").read_text()
    assert b"comment simulated: true" in next((tmp_path / "set" / "scans").iterdir()).read_bytes()[:200]
