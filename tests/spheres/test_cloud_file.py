"""Clouds of other programs: all properties in their types, nothing of a file that is not whole or not of numbers."""

import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.exports.clouds import write_cloud
from mbcacq.files.open3d_library import open3d
from mbcacq.spheres.cloud_file import CloudFile, in_mm, looks_small, read_cloud_file
from mbcacq.spheres.ply import read_cloud

ROWS = [(1.5, -2.0, 300.25, 40000, 65535), (2.5, 0.0, 301.0, 1, 0), (-3.5, 1.0, 299.5, 500, 256)]
TYPE = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<u2"), ("red", "<u2")])
NAMES = {"f4": "float", "u2": "ushort", "f8": "double"}


def ply(kind="binary_little_endian", rows=ROWS, announced=None, order="<", more=b""):
    head = f"ply\nformat {kind} 1.0\nelement vertex {announced or len(rows)}\n"
    head += "".join(f"property {NAMES[t]} {n}\n" for n, t in zip(TYPE.names, ("f4", "f4", "f4", "u2", "u2"), strict=True)) + "end_header\n"
    if kind == "ascii":
        return head.encode() + "".join(" ".join(map(str, row)) + "\n" for row in rows).encode() + more
    return head.encode() + np.array(rows, TYPE).astype(TYPE.newbyteorder(order)).tobytes() + more


def pcd(kind="ascii", rows=ROWS, announced=None, data=None):
    head = f"# .PCD v.7\nVERSION .7\nFIELDS x y z intensity red\nSIZE 4 4 4 2 2\nTYPE F F F U U\nCOUNT 1 1 1 1 1\nWIDTH {len(rows)}\nHEIGHT 1\n"
    head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {announced or len(rows)}\nDATA {kind}\n"
    if data is None:
        data = np.array(rows, TYPE).tobytes() if kind == "binary" else "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    return head.encode() + data


@pytest.fixture
def read(tmp_path):
    def read(data, name):
        (tmp_path / name).write_bytes(data)
        return read_cloud_file(tmp_path / name)

    return read


def literal_lzf(data):
    """LZF of literal runs, with one copy of 32 zero bytes in front to show overlapping copies."""
    out = b"\x00\x00" + bytes([7 << 5, 22]) + b"\x00"  # one zero, then 31 more copied from one byte before
    for i in range(0, len(data), 32):
        out += bytes([len(data[i : i + 32]) - 1]) + data[i : i + 32]
    return out


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (ply(), "a.ply"),
        (ply("binary_big_endian", order=">"), "a.ply"),
        (ply("ascii"), "a.ply"),
        (ply("ascii").replace(b"\n", b"\r\n"), "a.ply"),
        (pcd(), "a.pcd"),
        (pcd("binary"), "a.pcd"),
    ],
    ids=["little", "big", "text", "CRLF", "PCD text", "PCD binary"],
)
def test_sixteen_bits_stay_sixteen_bits(read, tmp_path, data, name):
    found = read(data, name)
    assert found.points.tolist() == [list(row[:3]) for row in ROWS]
    assert {n: (v.dtype, v.tolist()) for n, v in found.properties.items()} == {
        "intensity": (np.dtype("u2"), [40000, 1, 500]),
        "red": (np.dtype("u2"), [65535, 0, 256]),
    }
    write_cloud(tmp_path / "out.ply", found.points, found.properties, np.eye(4))
    again = read_cloud_file(tmp_path / "out.ply")
    assert again.points.dtype == np.float64
    assert again.points.tolist() == found.points.tolist()
    assert again.properties["intensity"].tolist() == [40000, 1, 500]


def test_compressed_pcd_and_packed_colours(read, tmp_path):
    x = np.zeros(8, "<f4")
    y, z = np.arange(8, dtype="<f4"), np.arange(8, dtype="<f4") + 300
    packed = np.full(8, 0x00FF8001, "<u4")
    plain = b"".join(v.tobytes() for v in (x, y, z, packed))
    small = literal_lzf(plain[32:])
    head = "VERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 8\nHEIGHT 1\nPOINTS 8\nDATA binary_compressed\n"
    data = head.encode() + np.array([len(small), len(plain)], "<u4").tobytes() + small
    found = read(data, "a.pcd")
    assert found.points[5].tolist() == [0, 5, 305]
    assert [found.properties[c][0] for c in ("red", "green", "blue")] == [255, 128, 1]
    with pytest.raises(ConfigError, match="compressed points are"):
        read(data[:-3], "a.pcd")
    for at in (0, 4):  # sizes beyond what 32 bits hold with the eight before them: no warning of an overflow either
        begin = len(head) + at
        with pytest.raises(ConfigError, match="compressed points are not whole"):
            read(data[:begin] + b"\xff" * 4 + data[begin + 4 :], "a.pcd")
    with pytest.raises(ConfigError, match="holds no points"):
        read(data.replace(b"POINTS 8", b"POINTS " + b"9" * 30), "a.pcd")
    with pytest.raises(ConfigError, match="a name of its fields is no ASCII"):
        read(data.replace(b" rgb", b" \x80rgb"), "a.pcd")


def test_what_another_library_writes_is_read(tmp_path):
    o3d, points = open3d(), np.random.default_rng(0).normal(size=(200, 3)).astype(np.float32)
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(points))
    for name, options in (("a.ply", {}), ("a.pcd", {}), ("b.pcd", {"compressed": True}), ("c.pcd", {"write_ascii": True})):
        o3d.t.io.write_point_cloud(str(tmp_path / name), cloud, **options)
        np.testing.assert_allclose(read_cloud_file(tmp_path / name).points, points, atol=1e-5)


@pytest.mark.parametrize(
    ("data", "name", "sentence"),
    [
        (ply("ascii", announced=5), "a.ply", "is cut off"),
        (ply(announced=5), "a.ply", "is cut off"),
        (ply(more=b"12345"), "a.ply", "where its header announces"),
        (ply("ascii", more=b"9 9 9 9 9\n"), "a.ply", "its header announces 3 lines and 4 follow"),
        (ply("ascii", announced=2), "a.ply", "its header announces 2 lines and 3 follow"),
        (pcd(announced=2), "a.pcd", "has 3 lines of points where its header announces 2"),
        (pcd("binary", announced=2), "a.pcd", "where its header announces"),
        (ply("ascii").replace(b"300.25", b"300,25"), "a.ply", "point 1: '300,25' is not a number; decimal commas are not read"),
        (ply("ascii").replace(b"300.25", b"0x1F"), "a.ply", "point 1: '0x1F' is not a number"),
        (ply("ascii").replace(b"300.25 ", b""), "a.ply", "point 1 has 4 numbers where its header announces 5"),
        (ply("ascii").replace(b"40000", b"70000"), "a.ply", "intensity is 70000, which is no uint16"),
        (ply("ascii").replace(b"300.25", b"inf"), "a.ply", "point 1 has a coordinate that is no finite number"),
        (ply("ascii").replace(b"300.25", b"nan"), "a.ply", "point 1 has a coordinate that is no finite number"),
        (pcd(announced=5), "a.pcd", "has 3 lines of points where its header announces 5"),
        (pcd().replace(b"300.25", b"300,25"), "a.pcd", "decimal commas are not read"),
        (pcd("binary", announced=5), "a.pcd", "where its header announces"),
        (pcd().replace(b"FIELDS x y z", b"FIELDS a y z"), "a.pcd", "holds no points"),
        (pcd().replace(b"TYPE F F F U U", b"TYPE F F F U"), "a.pcd", "lacks FIELDS, SIZE, TYPE"),
        (pcd("ebcdic"), "a.pcd", "DATA ebcdic is not known"),
    ],
)
def test_nothing_of_a_file_that_is_not_whole(read, data, name, sentence):
    with pytest.raises(ConfigError, match=sentence):
        read(data, name)


def test_a_last_number_that_is_cut_is_seen(read):
    rows = b"".join(b"%d.2500 -2.5000 30%d.1250\n" % (i, i % 10) for i in range(20))
    head = b"ply\nformat ascii 1.0\nelement vertex 20\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    assert len(read(head + rows.rstrip(), "a.ply").points) == 20
    with pytest.raises(ConfigError, match="is cut off in its last number, '309.1'"):
        read(head + rows[:-4], "a.ply")


def test_places_without_a_point_are_left_out(read):
    found = read(ply(rows=[(np.nan, np.nan, np.nan, 7, 7), *ROWS]), "a.ply")
    assert (len(found.points), found.missing) == (3, 1)
    assert found.properties["intensity"].tolist() == [40000, 1, 500]


def test_a_cloud_in_metres_is_asked_about():
    points = np.random.default_rng(0).uniform(-0.05, 0.35, (100, 3))
    cloud = CloudFile(points, {}, 0)
    with pytest.raises(ConfigError, match="looks like metres; say --unit m"):
        in_mm("scan.ply", cloud, None)
    np.testing.assert_allclose(in_mm("scan.ply", cloud, "m"), 1e3 * points)
    assert in_mm("scan.ply", cloud, "mm") is points
    with pytest.raises(ConfigError, match="looks like um"):
        in_mm("scan.ply", CloudFile(1e6 * points, {}, 0), None)
    assert in_mm("scan.ply", CloudFile(1e3 * points, {}, 0), None).max() > 100


@pytest.mark.parametrize(
    ("line", "factor"),
    [
        (b"comment unit mm", 1.0),
        (b"comment Units: meters", 1e3),
        (b"obj_info unit = inch", 25.4),
        (b"comment all coordinates in inches", 25.4),
        (b"comment length unit: feet", 304.8),
        (b"comment", 1.0),
        (b"comment normals are unit vectors", 1.0),
        (b"comment angle unit: deg", 1.0),
    ],
)
def test_a_unit_in_the_header_is_honoured(read, tmp_path, line, factor):
    found = read(ply("ascii").replace(b"element vertex", line + b"\nelement vertex"), "a.ply")
    np.testing.assert_allclose(in_mm("a.ply", found, None), factor * found.points.astype(float), rtol=1e-12)
    np.testing.assert_allclose(read_cloud(tmp_path / "a.ply"), factor * found.points.astype(float), rtol=1e-12)
    assert in_mm("a.ply", found, "mm") is found.points
    found = read(pcd().replace(b"VERSION", line.replace(b"comment", b"#").replace(b"obj_info", b"#") + b"\nVERSION"), "a.pcd")
    np.testing.assert_allclose(in_mm("a.pcd", found, None), factor * found.points.astype(float), rtol=1e-12)


def test_a_unit_that_is_no_length_is_refused(read):
    with pytest.raises(ConfigError, match="the unit 'furlogs' is no length"):
        read(ply("ascii").replace(b"element vertex", b"comment units: furlogs\nelement vertex"), "a.ply")


@pytest.mark.parametrize(("place", "moved"), [(b"0 0 0 1 0 0 0", False), (b"0 0 0.5 1 0 0 0", True), (b"0 0 0 0.7071 0 0.7071 0", True)])
def test_a_viewpoint_other_than_the_origin_is_seen(read, place, moved):
    assert read(pcd().replace(b"VIEWPOINT 0 0 0 1 0 0 0", b"VIEWPOINT " + place), "a.pcd").viewpoint is moved


def test_normals_turn_with_the_points(tmp_path):
    T = np.eye(4)
    T[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    write_cloud(tmp_path / "a.ply", np.ones((1, 3)), {"nx": np.ones(1), "ny": np.zeros(1), "nz": np.zeros(1), "id": np.array([7])}, T)
    found = read_cloud_file(tmp_path / "a.ply")
    assert [float(found.properties[n][0]) for n in ("nx", "ny", "nz", "id")] == [0, 1, 0, 7]


def test_a_cloud_that_is_25_times_too_small_is_said():
    """A scan of 150 mm by 100 mm in inches, of a scanner that saw balls 40 mm apart at once."""
    centres = np.array([[0.0, 0, 0], [40, 3, 2], [5, 40, -3], [45, 41, 6]])
    scan = np.random.default_rng(2).uniform([-75, -50, 250], [75, 50, 280], (500, 3))
    assert "if it is in inches, say --unit in" in looks_small(scan / 25.4, centres)
    assert looks_small(scan, centres) == ""
    assert looks_small(scan / 25.4, centres[:2]) == ""  # of a bar nobody knows whether its balls were seen together
