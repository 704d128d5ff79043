"""Tables as instruments and controllers write them: headings behind lines of other text, columns apart by blanks, joints from 0."""

import pytest

from mbcacq.errors import ConfigError
from mbcacq.files.table import read_table
from mbcacq.recording.datasets.columns import joint_columns, names_poses, target_columns, unit_above

LOGS = {
    "RTDE": ("timestamp actual_q_0 actual_q_1 actual_q_2 actual_q_3 actual_q_4 actual_q_5\n1.0 0.1 0.2 0.3 0.4 0.5 0.6\n", None, 6),
    "points": ("// an export of points\n// Units: mm\nCollection  Group  Point  X  Y  Z\nA  G1  p1  1000.5 200.25 -3.0\n", "mm", 0),
    "NumPy": ("# x y z\n1.5 2.5 3.5\n4.5 5.5 6.5\n", None, 0),
    "units twice": ("AT960\nUnits: inch\nTime [s]  X [in]  Y [in]  Z [in]\n1  1.5 2.5 3.5\n2  4.5 5.5 6.5\n", "in", 0),
    "commas": ("Instrument 1\nUnits: m\n\nX,Y,Z\n1.5,2.5,3.5\n", "m", 0),
    "tabs": ("station\t1\nX [mm]\tY [mm]\tZ [mm]\n1,5\t2,5\t3,5\n", None, 0),
}


@pytest.mark.parametrize("log", LOGS, ids=str)
def test_headings_are_found_where_they_stand(tmp_path, log):
    text, unit, joints = LOGS[log]
    (tmp_path / "a.txt").write_text(text)
    table = read_table(tmp_path / "a.txt", headings=names_poses)
    last = text.splitlines()[-1].split()[-1].replace(",", ".") if log != "commas" else "3.5"
    assert unit_above(table) == unit
    assert len(joint_columns(table)) == joints
    name = joint_columns(table)[-1] if joints else target_columns(table).translation[2]
    table.expect_decimals([name])
    assert table.number(name)[-1] == float(last)
    assert table.line[-1] == len(text.splitlines())


def test_a_unit_above_the_headings_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.txt").write_text("Units: cubits\nX,Y,Z\n1,2,3\n")
    with pytest.raises(ConfigError, match="the unit 'cubits' above the headings"):
        unit_above(read_table(tmp_path / "a.txt", headings=names_poses))
