"""Clouds in the formats of scanners' programs: the same points, whatever wrote them; what is broken is named."""

import numpy as np
import pytest
import tifffile

from mbcacq.devices import ConfigError
from mbcacq.spheres.cloud_files import CloudFormat, read_points

POINTS = np.array([[1.5, 2.25, -3.0], [4.0, -5.5, 6.125], [7.0, 8.0, 9.0]])


@pytest.mark.parametrize(
    "text",
    [
        "1.5 2.25 -3.0\n4.0 -5.5 6.125\n7 8 9\n",
        "3\n1.5 2.25 -3.0 255\n4.0 -5.5 6.125 12\n7 8 9 0\n",
        "# a cloud\nx,y,z\n1.5,2.25,-3.0\n4.0,-5.5,6.125\n7,8,9\n",
        "x;y;z\n1,5;2,25;-3,0\n4,0;-5,5;6,125\n7,0;8,0;9,0\n",
        "1,5 2,25 -3\n4 -5,5 6,125\n7 8 9\n",
        "1,5\t2,25\t-3,0\n4,0\t-5,5\t6,125\n7\t8\t9\n",
        "1.5;2.25;-3.0;0.1;0.2\n4.0;-5.5;6.125;1;1\n7;8;9;1;1\n\n",
    ],
)
@pytest.mark.parametrize("suffix", ["xyz", "asc", "txt"])
def test_texts(tmp_path, text, suffix):
    path = tmp_path / f"a.{suffix}"
    path.write_text(text)
    assert read_points(path) == pytest.approx(POINTS)
    path.write_text(text, encoding="utf-16")
    assert read_points(path) == pytest.approx(POINTS)


@pytest.mark.parametrize(
    ("above", "factor"),
    [
        ("X [m], Y [m], Z [m]", 1e3),
        ("x_in y_in z_in", 25.4),
        ("# units: cm\nx y z", 10.0),
        ('X(");Y(");Z(")', 25.4),
        ("x y z intensity", 1.0),
        ("// a unit sphere", 1.0),
    ],
)
def test_a_unit_above_the_points_is_honoured(tmp_path, above, factor):
    path = tmp_path / "a.xyz"
    path.write_text(above + "\n1.5 2.25 -3.0\n4.0 -5.5 6.125\n7 8 9\n")
    assert read_points(path) == pytest.approx(factor * POINTS)
    assert read_points(path, CloudFormat("mm")) == pytest.approx(POINTS)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("X [deg], Y [deg], Z [deg]\n1 2 3\n", "the headings name 'deg', which is no one unit of length"),
        ("1 2 3\n4 5", "a.xyz:2: the file is cut off in its last line"),
        ("1 2 3\n4 no 6\n7 8 9", "a.xyz:2: '4 no 6' is no x, y, z"),
        ("1 2 3 255\n4 5 6\n7 8 9 1\n", "a.xyz:2: the line has 3 columns, the first one 4"),
        ("1,5 2,5 3,5\n1.234 2,5 3,5\n", "a.xyz:2: has a point in a cloud with decimal commas"),
        ("1,5,2,5,3,5\n4,5,5,5,6,5\n", "a.xyz:1: its 6 columns of whole numbers may be numbers with decimal commas"),
        ("4\n1 2 3\n4 5 6\n7 8 9\n", "a.xyz:1: announces 4 points, and 3 follow"),
        ("hello", "none of its first lines has three numbers"),
    ],
)
def test_broken_texts_name_the_line(tmp_path, text, sentence):
    path = tmp_path / "a.xyz"
    path.write_text(text)
    with pytest.raises(ConfigError, match=sentence):
        read_points(path)


def test_the_first_line_says_nothing_of_decimal_commas_below(tmp_path):
    path = tmp_path / "a.xyz"
    path.write_text("7 8 9\n1,5 2,25 -3\n")
    assert read_points(path) == pytest.approx(POINTS[[2, 0]])


def test_stl_binary_and_text(tmp_path):
    binary = tmp_path / "b.stl"
    facet = np.zeros(1, dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    facet["v"] = POINTS
    binary.write_bytes(bytes(80) + (1).to_bytes(4, "little") + facet.tobytes())
    corners = "".join(f"vertex {x} {y} {z}\n" for x, y, z in POINTS)
    text = tmp_path / "t.stl"
    text.write_text(f"solid s\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid s\n")
    wanted = POINTS[np.lexsort(POINTS.T[::-1])]
    assert read_points(binary) == pytest.approx(wanted)
    assert read_points(text) == pytest.approx(wanted)
    binary.write_bytes(binary.read_bytes()[:-7])
    text.write_text(text.read_text()[:-20])
    for path in (binary, text):
        with pytest.raises(ConfigError, match="is cut off"):
            read_points(path)


def test_pcd_that_is_too_short_is_named(tmp_path):
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA binary\n"
    )
    path = tmp_path / "a.pcd"
    path.write_bytes(head.encode() + POINTS.astype("<f4").tobytes())
    assert read_points(path) == pytest.approx(POINTS)
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(ConfigError, match="has 32 bytes of points where its header announces 36"):
        read_points(path)


def test_a_range_map_needs_its_scale(tmp_path):
    path = tmp_path / "map.tif"
    counts = np.zeros((3, 5), dtype=np.uint16)
    counts[0, 0], counts[2, 4] = 1000, 2000
    tifffile.imwrite(path, counts)
    with pytest.raises(ConfigError, match="a range map says no millimetres"):
        read_points(path)
    found = read_points(path, CloudFormat(range_map=(0.5, 0.25, 0.01, -20.0)))
    assert found == pytest.approx(np.array([[-1.0, -0.25, -10.0], [1.0, 0.25, 0.0]]))
    path.write_bytes(path.read_bytes()[:30])
    with pytest.raises(ConfigError, match="is no whole TIFF file"):
        read_points(path, CloudFormat(range_map=(1, 1, 1, 0)))


def test_units_and_axes(tmp_path):
    path = tmp_path / "a.xyz"
    np.savetxt(path, POINTS / 1000)
    assert read_points(path, CloudFormat("m", "x -y -z")) == pytest.approx(POINTS * [1, -1, -1])
    assert read_points(path, CloudFormat("m", "z x y")) == pytest.approx(POINTS[:, [2, 0, 1]])
    for wrong in ("x y", "x y y", "a b c", "x y z z"):
        with pytest.raises(ConfigError, match="names no three axes"):
            read_points(path, CloudFormat(axes=wrong))


def test_a_range_map_whose_pages_are_a_ring_is_refused_by_its_first(tmp_path):
    """The only page is named as its own next one: a reader of all pages would not come to an end."""
    tifffile = pytest.importorskip("tifffile")
    path, form = tmp_path / "a.tif", CloudFormat(range_map=(1, 1, 1, 0))
    tifffile.imwrite(path, np.ones((5, 6), "<u2"))
    data = bytearray(path.read_bytes())
    first = int.from_bytes(data[4:8], "little")
    tags = int.from_bytes(data[first : first + 2], "little")
    data[first + 2 + 12 * tags : first + 6 + 12 * tags] = first.to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(ConfigError, match="save"):
        read_points(path, form)
    tifffile.imwrite(path, np.ones((3, 5, 6), "<u2"), photometric="minisblack")  # three pages
    with pytest.raises(ConfigError, match="save one channel"):
        read_points(path, form)
