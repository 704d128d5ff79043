"""TOOL_DATA as a KUKA controller keeps it."""

import subprocess

import numpy as np
import pytest
import read_back
from hypothesis import given
from hypothesis import strategies as st

from mbcacq.errors import ConfigError
from mbcacq.exports import kuka

# turned about Z by 90 deg, then about the new Y by 30 deg: A = 90, B = 30, C = 0
C30, S30 = np.cos(np.pi / 6), 0.5
TURNED = np.array([[0, -1, 0, 1.2621], [C30, 0, S30, -0.561], [-S30, 0, C30, 264.7998], [0, 0, 0, 1.0]])
CONFIG = (
    "DEFDAT  $CONFIG\r\n;FOLD GLOBALS\r\nDECL FRAME TOOL_DATA[32]\r\n"
    "TOOL_DATA[1]={X 0.0,Y 0.0,Z 100.0,A 0.0,B 0.0,C 0.0}\r\n"
    "TOOL_DATA[3]={X 1.0E+02,Y -2.5,Z 3.0,A 180.0,B 0.0,C -90.0}\r\n"
    'TOOL_NAME[3,]="Gr\xfcn"\r\nENDFOLD\r\nENDDAT\r\n'
)


def test_the_snippet_reads_as_on_the_controller():
    assert kuka.tool_data(TURNED, 3, "scanner") == (
        'TOOL_DATA[3]={X 1.26210,Y -0.56100,Z 264.79980,A 90.000000,B 30.000000,C 0.000000}\r\nTOOL_NAME[3,]="scanner"\r\n'
    )


@given(st.lists(st.floats(-179, 179), min_size=3, max_size=3), st.lists(st.floats(-900, 900), min_size=3, max_size=3))
def test_what_is_written_is_read_back(abc, xyz):
    a, b, c = np.radians(abc)
    Rz = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    Ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    Rx = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rz @ Ry @ Rx, xyz
    np.testing.assert_allclose(read_back.tool_data(kuka.tool_data(T, 7), 7), T, atol=1e-5)


def test_the_diff_changes_two_lines_and_keeps_the_rest(tmp_path):
    path = tmp_path / "$config.dat"
    path.write_bytes(CONFIG.encode("latin-1"))
    diff = kuka.config_diff(path, TURNED, 3, "scanner")
    changed = [line for line in diff.splitlines() if line[:1] in "+-" and line[:3] not in ("+++", "---")]
    assert changed == [
        "-TOOL_DATA[3]={X 1.0E+02,Y -2.5,Z 3.0,A 180.0,B 0.0,C -90.0}",
        '-TOOL_NAME[3,]="Gr\xfcn"',
        "+TOOL_DATA[3]={X 1.26210,Y -0.56100,Z 264.79980,A 90.000000,B 30.000000,C 0.000000}",
        '+TOOL_NAME[3,]="scanner"',
    ]
    assert path.read_bytes() == CONFIG.encode("latin-1")


def test_patch_takes_the_diff(tmp_path):
    path = tmp_path / "config.dat"
    path.write_bytes(CONFIG.encode("latin-1"))
    (tmp_path / "tool.diff").write_bytes(kuka.config_diff(path, TURNED, 5, "scanner").encode("latin-1"))
    try:
        subprocess.run(["patch", "--binary", "-p1", "-i", "tool.diff"], cwd=tmp_path, check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip("no patch program on this machine")
    new = path.read_bytes().decode("latin-1")
    np.testing.assert_allclose(read_back.tool_data(new, 5), TURNED, atol=1e-5)
    assert new.endswith("ENDDAT\r\n")
    assert kuka.config_diff(path, TURNED, 5, "scanner") == ""


def test_what_a_controller_would_not_take_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="tool number 0"):
        kuka.tool_data(TURNED, 0)
    with pytest.raises(ConfigError, match="tool name"):
        kuka.tool_data(TURNED, 1, 'a"b')
    (tmp_path / "x.txt").write_text("hello\n")
    with pytest.raises(ConfigError, match="no \\$config.dat"):
        kuka.config_diff(tmp_path / "x.txt", TURNED, 1)
