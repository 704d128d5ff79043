"""Recordings below folders whose names are not plain ASCII, in a locale that knows only that."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mbcacq.errors import ConfigError
from mbcacq.recording.rrd.writer import Recorder

HERE = Path(__file__).parent
WORK = """
import sys
sys.path.insert(0, sys.argv[2])
import synthetic
from mbcacq.cli.app import app
from mbcacq.recording import load_observations
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.recording.run_folder.journal import Journal
with Recorder(sys.argv[1]) as recorder, Journal(sys.argv[1]) as journal:
    for event in synthetic.run():
        recorder(event)
        journal(event)
assert load_observations(sys.argv[1]).n_poses == 4
app(["recover", sys.argv[1]])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="file names of Windows have no encoding of their own")
@pytest.mark.parametrize("utf8_mode", ["0", "1"])
def test_an_umlaut_under_the_c_locale_is_no_torn_recording(tmp_path, utf8_mode):
    environment = {k: v for k, v in os.environ.items() if k != "LANG" and not k.startswith("LC_")}
    environment |= {"LC_ALL": "C", "PYTHONUTF8": utf8_mode, "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-c", WORK, os.fsencode(tmp_path / "Küche"), HERE]
    done = subprocess.run(command, env=environment, capture_output=True, timeout=900)
    assert done.returncode == 0, done.stderr
    assert b"nothing to do, 4 finished poses" in done.stdout
    assert (tmp_path / "Küche" / "run.rrd").exists()


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="file names there are always Unicode")
def test_a_name_that_is_not_utf8_is_refused_before_anything_is_measured(tmp_path):
    with pytest.raises(ConfigError, match="is not UTF-8"):
        Recorder(Path(os.fsdecode(os.fsencode(tmp_path) + b"/k\xfcche")))
