"""Tables as people and spreadsheets write them: the same numbers, or a refusal with file, line and column."""

import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.files.table import Column, TableSchema, joint_columns, read_table

DH = TableSchema(
    "a table of Denavit-Hartenberg rows",
    (Column("theta", "rad", written="deg"), Column("d", "mm"), Column("name", kind="text", required=False)),
)


def table(tmp_path, data, schema=DH):
    path = tmp_path / "t.csv"
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return read_table(path, schema)


@pytest.mark.parametrize(
    "text",
    [
        "theta_deg,d_mm\n90,500\n",
        "Theta [deg],D (mm)\n90,500\n",
        "theta (\u00b0),d in m\n90,0.5\n",
        "theta_rad,d / mm\n1.5707963267948966,500\n",
        "theta;d\n[deg];[cm]\n90,0;50,0\n",
        "sep=;\ntheta_deg;d_mm;;\r\n90;500;;\r\n;;;\r\n",
        "d_mm\ttheta_deg\r500\t90\r",
        'theta_deg,d_mm\n"90,0","500,0"\n',
        "theta_deg,d_mm\n90°,0.5 m\n",
        "theta_deg;d_mm\npi/2;50cm\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
def test_units_and_dialects_give_the_same_numbers(tmp_path, text, encoding):
    found = table(tmp_path, text.encode(encoding))
    assert found.number("theta") == pytest.approx([np.pi / 2], rel=1e-15)
    assert found.number("d") == pytest.approx([500.0], rel=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("theta_deg,d_mm\n90,5,0\n", r"t\.csv:2: column d_mm: the row has 3 cells, the header 2"),
        ("theta_deg,d_mm\n1_0,5\n", r"t\.csv:2: column theta_deg: '1_0' is not a number"),
        ("theta_deg,d_mm\n1,5\n" + "9" * 400 + ",5\n", r"t\.csv:3: column theta_deg: .* is not a finite number"),
        ("theta_deg,d_mm\n1\0,5\n", r"t\.csv:2: holds a NUL"),
        ("theta_deg,d_mm\n" + "1" * 140_000 + ",5\n", r"t\.csv:\d: not a CSV file"),
        ('theta_deg,d_mm\n"1,5\n', r"not a CSV file"),
        ("theta_deg,d\n90,5\n", r"t\.csv:1: column d_mm is missing: column d names no unit"),
        ("theta [Grad],d_mm\n90,5\n", r"'Grad' may be degrees \(deg\) or gon"),
        ("theta_deg,d [kg]\n90,5\n", r"d_mm cannot be given in kg"),
        ("theta_deg,theta_rad,d_mm\n90,1,5\n", r"columns theta_deg and theta_rad both give theta_deg"),
        ('theta_deg,d_mm\n90,"1,500"\n', r"column d_mm: '1,500' may have a decimal comma or one of thousands"),
        ('theta_deg,d_mm\n9.5,"1,5"\n', r"'9\.5' has a point in a file with decimal commas"),
        ("theta_deg,d_mm\n90 mm,5\n", r"column theta_deg: '90 mm' is not a number"),
        ("theta_deg,d_mm\npi/0,5\n", r"column theta_deg: 'pi/0' is not a number"),
        ("theta_deg;d_mm\n1,5;1.234\n", r"t\.csv:2: column d_mm: '1\.234' has a point in a file with decimal commas"),
        ("theta_deg,d_mm\n90,\n", r"t\.csv:2: column d_mm: the cell is empty"),
        ("theta_deg [9**9**9],d_mm\n", r"t\.csv:"),
        (b"PK\x03\x04rest", r"workbook"),
    ],
)
def test_what_would_change_a_number_is_refused_with_its_place(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        table(tmp_path, text).numbers(("theta", "d"))


def test_columns_that_nothing_uses_are_listed(tmp_path):
    found = table(tmp_path, "theta_deg,d_mm,comment,name\n1,2,x,A1\n")
    assert (found.unused, found.text("name")) == (("comment",), ("A1",))


def test_columns_are_added_in_the_dialect_of_the_file(tmp_path):
    found = table(tmp_path, "\ufefftheta_deg;d_mm\r\n1,5;2\r\n")
    assert found.with_columns({"q_deg": ["0.25"], "reason": ["a.b"]}).decode("utf-8") == (
        "\ufefftheta_deg;d_mm;q_deg;reason\r\n1,5;2;0,25;a.b\r\n"
    )


def test_joints_of_a_german_spreadsheet(tmp_path):
    schema = TableSchema("joints", joint_columns("q", 2, aliases=("A{}",), assumed="deg"))
    found = table(tmp_path, "A1;A2\n0;-90,5\n", schema)
    assert found.numbers(("q1", "q2")).tolist() == [[0.0, np.radians(-90.5)]]


def test_an_assumed_unit_is_never_taken_for_one_that_is_spelt_wrongly(tmp_path):
    schema = TableSchema("lengths", (Column("x", "mm", assumed="mm"),))
    assert table(tmp_path, "x (k=2)\n5\n", schema).number("x").tolist() == [5.0]
    assert table(tmp_path, '"x (µm, k = 2)"\n5\n', schema).number("x") == pytest.approx([0.005])
    with pytest.raises(ConfigError, match=r"t\.csv:1: column x \(my\): 'my' is no unit that can be given in mm"):
        table(tmp_path, "x (my)\n5\n", schema)
