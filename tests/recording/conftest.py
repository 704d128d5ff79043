from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def a_set(tmp_path: Path) -> Path:
    """A small correct observation set, for tests to spoil."""
    import synthetic

    folder = tmp_path / "set"
    folder.mkdir()
    (folder / "cell.yaml").write_text(synthetic.CELL)
    (folder / "poses.csv").write_text(
        "pose,station,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,air_C,remark\n"
        "10,1,0,-90,90,0,45,1.5,20.5,first\n"
        '11,far,10.25,-80,80,5,-45,0,20.75,"a, b"\n'
    )
    (folder / "centres.csv").write_text("pose,ball,x_mm,y_mm,z_mm,n_points\n10,1,1,2,3,100\n11,7,4,5,6,120\n10,2,-1,-2,-3,90\n")
    return folder


@pytest.fixture
def a_run(tmp_path: Path) -> Path:
    """A run folder written from synthetic events."""
    import synthetic

    from mbcacq.recording.rrd.writer import Recorder
    from mbcacq.recording.run_folder.journal import Journal

    folder = tmp_path / "run"
    with Recorder(folder) as recorder, Journal(folder) as journal:
        for event in synthetic.run():
            recorder(event)
            journal(event)
    return folder
