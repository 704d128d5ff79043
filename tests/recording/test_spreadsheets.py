"""Tables as spreadsheets write them: semicolons, decimal commas, one wide table."""

import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.files.table import read_table
from mbcacq.recording import load_observations

TRACKER = """
format: mbcacq-observation-set/1
measurement: target_in_base
robot:
  name: two axes
  links:
    - {theta_deg: 0, d_mm: 100, a_mm: 0, alpha_deg: 90}
    - {theta_deg: 0, d_mm: 0, a_mm: 300, alpha_deg: 0}
artefacts: [{id: target, balls: [{id: 1, centre_mm: [0, 0, 0]}]}]
stations: [{id: tracker, artefact: target}]
"""


def write(folder, poses, cell=TRACKER):
    folder.mkdir(exist_ok=True)
    (folder / "cell.yaml").write_text(cell)
    (folder / "poses.csv").write_bytes(poses.encode())
    return folder


def test_a_german_spreadsheet_gives_the_same_numbers(a_set):
    before = load_observations(a_set)
    for name in ("poses.csv", "centres.csv"):
        text = (a_set / name).read_text().replace('"a, b"', "a/b")
        (a_set / name).write_bytes(("\ufeff" + text.replace(",", ";").replace(".", ",")).replace("\n", "\r\n").encode())
    after = load_observations(a_set)
    assert np.array_equal(after.q, before.q)
    assert np.array_equal(after.xyz, before.xyz)
    assert after.temperatures["air_C"].tolist() == [20.5, 20.75]


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_are_read_beside_another_separator(tmp_path, separator):
    (tmp_path / "t.csv").write_text(separator.join(["a", "b"]) + "\n" + separator.join(["-1,5e-3", "7"]) + "\n")
    table = read_table(tmp_path / "t.csv")
    assert (table.number("a")[0], table.number("b")[0]) == (-0.0015, 7.0)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8-sig"])
def test_encodings_of_spreadsheets_and_their_empty_rows(tmp_path, encoding):
    path = tmp_path / "poses.csv"
    path.write_bytes("q1_deg;Bemerkung\r\n1,5;gepr\u00fcft\r\n;\r\n;;;\r\n".encode(encoding))
    table = read_table(path)
    assert table.number("q1_deg").tolist() == [1.5]
    assert table.text("Bemerkung") == ("gepr\u00fcft",)


def test_a_semicolon_with_decimal_points_is_read(tmp_path):
    (tmp_path / "t.csv").write_text("a;b\n1.5;2.25\n")
    assert read_table(tmp_path / "t.csv").number("b")[0] == 2.25


def test_a_separator_of_thousands_is_refused_with_its_place(tmp_path):
    (tmp_path / "t.csv").write_text("a;b\n1,5;2,0\n1.234,5;2,0\n")
    with pytest.raises(ConfigError, match=r"t\.csv:3: column a: '1\.234,5' has a point in a file with decimal commas"):
        read_table(tmp_path / "t.csv").number("a")


def test_one_wide_table_has_joints_and_target_in_a_row(tmp_path):
    obs = load_observations(
        write(tmp_path / "s", "q1_deg;q2_deg;x_mm;y_mm;z_mm;qw;qx;qy;qz\n0;90;1,5;2;3;1;0;0;0\n10,5;80;4;5;6;0;1;0;0\n")
    )
    assert obs.pose_id.tolist() == [1, 2]
    assert np.degrees(obs.q[1]).tolist() == [10.5, 80.0]
    assert obs.xyz.tolist() == [[1.5, 2, 3], [4, 5, 6]]
    assert obs.rotation is not None
    assert np.allclose(obs.rotation[1], np.diag([1, -1, -1]))


def test_a_wide_table_names_several_balls_and_leaves_out_those_not_seen(tmp_path):
    cell = TRACKER.replace("measurement: target_in_base\n", "").replace(
        "balls: [{id: 1, centre_mm: [0, 0, 0]}]", "balls: [{id: 1, centre_mm: [0, 0, 0]}, {id: 4, centre_mm: [50, 0, 0]}]"
    )
    rows = "pose,q1_deg,q2_deg,x1_mm,y1_mm,z1_mm,x4_mm,y4_mm,z4_mm\n7,0,90,1,2,3,4,5,6\n9,10,80,,,,7,8,9\n"
    obs = load_observations(write(tmp_path / "s", rows, cell))
    assert obs.pose_id.tolist() == [7, 9]
    assert obs.pose.tolist() == [0, 0, 1]
    assert obs.ball.tolist() == [0, 1, 1]
    assert obs.xyz.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]


def test_a_wide_table_of_several_stations_must_name_them(tmp_path):
    cell = TRACKER.replace("stations: [", "stations: [{id: other, artefact: target}, ")
    with pytest.raises(ConfigError, match="column station is missing, and cell.yaml has 2 stations"):
        load_observations(write(tmp_path / "s", "q1_deg,q2_deg,x_mm,y_mm,z_mm\n0,90,1,2,3\n", cell))
