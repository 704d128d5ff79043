"""What is wrong with a set is said with file, line and column."""

from __future__ import annotations

import re

import pytest

from mbcacq.errors import ConfigError
from mbcacq.recording import load_observations

FAULTS = [
    ("poses.csv", "10.25", "ten", r"poses\.csv:3: column q1_deg: 'ten' is not a number"),
    ("poses.csv", "10.25", "nan", r"poses\.csv:3: column q1_deg: 'nan' is not a finite number"),
    ("poses.csv", "10.25", "-inf", r"poses\.csv:3: column q1_deg: '-inf' is not a finite number"),
    ("poses.csv", "10.25", "1_0", r"poses\.csv:3: column q1_deg: '1_0' is not a number"),
    ("poses.csv", "10.25", "", r"poses\.csv:3: column q1_deg: the cell is empty"),
    ("poses.csv", "10.25", "10,25", r"poses\.csv:3: column remark: the row has 11 cells, the header 10"),
    ("poses.csv", "11,far", "10,far", r"poses\.csv:3: column pose: pose 10 appears twice \(first in line 2\)"),
    ("poses.csv", "11,far", "11.5,far", r"poses\.csv:3: column pose: '11.5' is not an integer"),
    ("poses.csv", "11,far", "11,near", r"poses\.csv:3: column station: station 'near' is not in cell\.yaml \(there: 1, far\)"),
    ("poses.csv", "q6_deg", "Q6", r"poses\.csv:1: column q6_deg is missing"),
    ("poses.csv", "q6_deg", "q5_deg", r"poses\.csv:1: column q5_deg appears twice"),
    ("poses.csv", ",", "|", r"poses\.csv:1: column pose, station, .* is missing"),
    ("cell.yaml", "d_mm: 515", "d: 515", r"cell\.yaml:9: the key .d. is not known; .d_mm. is meant"),
    ("cell.yaml", "stations:", "staitons:", r"cell\.yaml:2\d: the key .staitons. is not known; .stations. is meant"),
    ("poses.csv", "first", '"first', r"poses\.csv:3: not a CSV file"),
    ("centres.csv", "10,2,", "10,1,", r"centres\.csv:4: column ball: this ball was already given for this pose \(line 2\)"),
    ("centres.csv", "11,7", "12,7", r"centres\.csv:3: column pose: pose 12 is not in poses\.csv"),
    ("centres.csv", "11,7", "11,9", r"centres\.csv:3: column ball: ball 9 is on no artefact"),
    ("centres.csv", "z_mm", "z", r"centres\.csv:1: column z_mm is missing"),
    ("centres.csv", "4,5,6", "4,5,1e999", r"centres\.csv:3: column z_mm: '1e999' is not a finite number"),
    ("cell.yaml", "sign: -1", "sign: 2", r"cell\.yaml:6: robot\.links\[0\]\.sign"),
    ("cell.yaml", "d_mm: 515", "d_mm: .nan", r"cell\.yaml:9: robot\.links\[3\]\.d_mm"),
    ("cell.yaml", "id: 7, ", "id: 1, ", r"cell\.yaml:19: ball id 1 is used twice"),
    ("cell.yaml", "id: far, artefact: mbc", "id: far, artefact: bar", r"cell\.yaml:22: station 'far' names the artefact 'bar'"),
    ("cell.yaml", "id: far", "id: 1", r"cell\.yaml:22: stations: id '1' is used twice"),
    ("cell.yaml", "abc_deg: [10, 20, 30]", "rotation: [[1,0,0],[0,1,0],[0,0,-1]]", r"cell\.yaml:12: the rotation matrix is not"),
    ("cell.yaml", "d_mm: 515", "d_mm: 515, d_mm: 516", r"cell\.yaml:9: key 'd_mm' stands here a second time"),
    ("cell.yaml", "stations:", "stations: [", r"cell\.yaml:\d+: not valid YAML"),
    ("cell.yaml", "observation-set/1", "observation-set/2", r"cell\.yaml:1: it was written by a newer mbcacq"),
]


@pytest.mark.parametrize(("file", "old", "new", "message"), FAULTS, ids=[f"{f[0]}: {f[1]} -> {f[2]}" for f in FAULTS])
def test_a_fault_is_named_with_its_place(a_set, file, old, new, message):
    text = (a_set / file).read_text()
    assert old in text
    (a_set / file).write_text(text.replace(old, new) if old == "," else text.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        load_observations(a_set)
    assert re.search(message, str(caught.value)), str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("file", ["poses.csv", "centres.csv"])
def test_a_file_without_rows_is_refused(a_set, file):
    header = (a_set / file).read_text().splitlines()[0]
    (a_set / file).write_text(header + "\n")
    with pytest.raises(ConfigError, match="no rows below the header"):
        load_observations(a_set)
    (a_set / file).write_text("")
    with pytest.raises(ConfigError, match="the file is empty"):
        load_observations(a_set)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [("", "it is empty; write it as lines"), ("# nothing\n", "it is empty"), ("- a\n", "it is a list"), ("12\n", "it is a single value")],
)
def test_a_cell_without_keys_is_refused_in_words(a_set, text, sentence):
    (a_set / "cell.yaml").write_text(text)
    with pytest.raises(ConfigError, match=rf"cell\.yaml:1: .*{sentence}"):
        load_observations(a_set)


def test_a_direction_other_than_minus_one_zero_and_one_is_refused(a_set):
    path = a_set / "poses.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head + ",dir1,dir2,dir3,dir4,dir5,dir6", rows[0] + ",1,0,-1,1,1,1", rows[1] + ",1,0,-1,2,1,1"]))
    with pytest.raises(ConfigError, match=r"poses\.csv:3: column dir4: '2' is not -1, 0 or 1"):
        load_observations(a_set)


def test_a_quaternion_that_is_not_of_unit_length_is_refused(a_set):
    path = a_set / "centres.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head + ",qw,qx,qy,qz", rows[0] + ",1,0,0,0", rows[1] + ",0.9,0,0,0", rows[2] + ",1,0,0,0"]))
    with pytest.raises(ConfigError, match=r"centres\.csv:3: column qw: qw, qx, qy, qz have length 0.9, not 1"):
        load_observations(a_set)


def test_bytes_that_are_no_text_are_refused(a_set):
    path = a_set / "poses.csv"
    path.write_bytes(path.read_bytes().replace(b"first", b"caf\xe9"))
    with pytest.raises(ConfigError, match=r"poses\.csv:2: not UTF-8 text \(byte 0xe9\)"):
        load_observations(a_set)


def test_a_set_with_neither_centres_nor_clouds_is_refused(a_set):
    (a_set / "centres.csv").unlink()
    with pytest.raises(ConfigError, match=r"neither centres\.csv nor a folder scans"):
        load_observations(a_set)


def test_a_path_that_is_no_data_is_refused_with_what_is_accepted(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    for path in (tmp_path, tmp_path / "notes.txt", tmp_path / "absent"):
        with pytest.raises(ConfigError, match=r"a run folder \(with run\.rrd\), a recording \(\.rrd\), or an observation-set folder"):
            load_observations(path)


def test_keys_of_other_programs_are_ignored(a_set):
    path = a_set / "cell.yaml"
    plain = load_observations(a_set)
    text = path.read_text()
    text = (
        text.replace("d_mm: 515", "colour: red, d_mm: 515")
        .replace("id: 7, ", "id: 7, glued: true, ")
        .replace("id: far", "shelf: 3, id: far")
    )
    path.write_text(text + "made_by: another program\n")
    assert text.count("colour") == text.count("glued") == text.count("shelf") == 1
    strange = load_observations(a_set)
    assert strange.cell.ball_ids == plain.cell.ball_ids
    assert (strange.cell.robot.chain.rows == plain.cell.robot.chain.rows).all()
