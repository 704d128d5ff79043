"""Pictures are drawn of poses: who asks for them of motion alone hears so, and nothing is dropped silently."""

import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app


@pytest.mark.parametrize("options", [["--report"], ["--rrd"], ["--report", "--rrd"]])
def test_a_page_of_motion_alone_is_refused_by_name(options, tmp_path, monkeypatch):
    monkeypatch.setattr("mbcacq.workflow.diagnose_recordings.is_trajectory", lambda data: True)
    files = [word for option in options for word in (option, str(tmp_path / option[2:]))]
    done = CliRunner().invoke(app, ["diagnose", str(tmp_path), *files])
    assert done.exit_code == 2
    assert f"{' and '.join(options)} would show nothing" in done.stderr
    assert not list(tmp_path.iterdir())
