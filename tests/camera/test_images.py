"""Hand-eye from images of boards that were rendered from a known truth."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("cv2")
import cv2
import rendered_boards
from rendered_boards import BOARDS, DISTORTION, SIZE, K, make, write

import mbcacq
from mbcacq.camera.adjustment import BoardView, adjust_images
from mbcacq.camera.board import Board, board_of
from mbcacq.camera.intrinsics import Intrinsics, read_intrinsics
from mbcacq.cli.app import app
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.geometry import se3
from mbcacq.recording.datasets.image_set import read_images
from mbcacq.recording.datasets.loose_table import TableOptions, table_of

ALONE = mbcacq.CalibrationOptions(kinematics=False)
COLMAP = f"1 OPENCV 640 480 {K[0, 0]} {K[1, 1]} {K[0, 2] + 0.5} {K[1, 2] + 0.5} {' '.join(map(str, DISTORTION[:4]))}\n"
TRUE = Intrinsics(K[[0, 1], [0, 1]], K[:2, 2], DISTORTION)


def read(cell, folder, camera=None, **said):
    images, flange = write(cell, folder)
    options = TableOptions(flange="vector", **said)
    return read_images([images], table_of(flange, options), cell.board, camera, options)


def error_in_sigmas(cell, obs):
    """Mean squared error of the six parameters in stated standard deviations, and the error of the place, mm."""
    found = mbcacq.calibrate(obs, ALONE)
    if obs.cell.measurement == "target_in_base":
        T, C, truth = found.state.T_base_station[0], found.fit.station_covariance[0], cell.Z
    else:
        rows = [found.names.index(f"hand_eye.{c}") for c in ("x", "y", "z", "rx", "ry", "rz")]
        T, C, truth = found.state.T_flange_scanner, found.covariance[np.ix_(rows, rows)], cell.X
    off = se3.inverse(truth) @ T
    twist = np.r_[off[:3, 3], se3.rotation_log(off[:3, :3])]
    return float(twist @ np.linalg.solve(C, twist) / 6), float(np.linalg.norm(off[:3, 3])), found


@pytest.fixture(scope="module")
def charuco():
    return make("charuco", np.random.default_rng(6), poses=10)


def test_camera_and_hand_eye_are_found_at_once_within_their_uncertainty(charuco, tmp_path):
    found = read(charuco, tmp_path / "a")
    nees, mm, cell = error_in_sigmas(charuco, found.observations)
    assert nees < 3.7  # chi square of six degrees of freedom over six, at 1e-3
    assert mm < 0.2
    # Poses of the flange tell more of the intrinsics than the images alone, and both hold the truth.
    alone = np.linalg.norm(found.observations.images.root, axis=1)
    together = cell.extra["images"]["intrinsics"]
    for name, truth, before in zip(("fx", "fy", "cx", "cy"), TRUE.values, alone, strict=False):
        assert abs(together[name]["value"] - truth) < 4 * together[name]["std"] < 4 * before
    assert together["fx"]["std"] < 0.8 * alone[0]


@pytest.mark.parametrize(("kind", "fixed"), [("chessboard", True), ("april", False), ("circles", True)])
def test_other_boards_and_a_fixed_camera_with_given_intrinsics(kind, fixed, tmp_path):
    cell = make(kind, np.random.default_rng(5), poses=9, fixed=fixed)
    (tmp_path / "cameras.txt").write_text("# of COLMAP\n" + COLMAP)
    found = read(cell, tmp_path / "a", tmp_path / "cameras.txt")
    assert found.observations.cell.measurement == ("target_in_base" if fixed else "artefact_in_scanner")
    nees, mm, _ = error_in_sigmas(cell, found.observations)
    assert nees < 3.7
    assert mm < 0.2


def test_a_board_that_looks_alike_when_turned_is_told_by_the_flange(monkeypatch, tmp_path):
    upright = rendered_boards.camera_pose

    def turned(board, rng, whole):
        T, middle = upright(board, rng, whole), se3.transform(np.eye(3), board.points.max(axis=0) / 2)
        half = se3.transform(np.diag([-1.0, -1, 1]), np.zeros(3))
        return T @ middle @ half @ se3.inverse(middle) if rng.random() < 0.5 else T

    monkeypatch.setattr(rendered_boards, "camera_pose", turned)
    cell = make("circles", np.random.default_rng(5), poses=9)
    assert len(BOARDS["circles"].turns) == 2
    nees, mm, found = error_in_sigmas(cell, read(cell, tmp_path / "a").observations)
    assert not found.fit.rejected
    # The board's frame may be either; the camera on the flange is the same.
    assert mm < 0.2
    assert nees < 3.7


def test_images_that_contradict_are_named(charuco, tmp_path):
    images, flange = write(charuco, tmp_path / "a")
    torn = cv2.imread(str(images / "view4.png"), 0)
    torn[:, 320:] = np.roll(torn, 9, axis=1)[:, 320:]
    cv2.imwrite(str(images / "view4.png"), torn)
    cv2.imwrite(str(images / "view9.png"), np.full_like(torn, 128))
    shutil.copy(images / "view2.png", images / "view6.png")  # of another pose
    made = CliRunner().invoke(app, [
        "data", "new", str(images), "--poses", str(flange), "--board", "charuco", "--size", "8x6", "--pitch", "20", "--inner", "15",
        "--dictionary", "4X4_50", "--out", str(tmp_path / "set"),
    ])  # fmt: skip
    assert made.exit_code == 0, made.output
    assert "not used: view4.png (no pose of a board explains it" in made.output
    assert "not used: view9.png (the board was not found)" in made.output
    done = CliRunner().invoke(app, ["calibrate", str(tmp_path / "set"), "--hand-eye-only"])
    assert "Rejected as outliers: 1: pose 5 of view6.png" in done.output
    content = json.loads((tmp_path / "set" / "images.json").read_text())
    assert [one["pose"] for one in content["images"][:6]] == [1, 2, 3, None, 4, 5]
    page = CliRunner().invoke(app, ["report", str(tmp_path / "set"), "--out", str(tmp_path / "page.html")])
    assert page.exit_code == 0, page.output
    text = (tmp_path / "page.html").read_text()
    assert "<td>view4.png</td>" in text
    assert "shared_1" not in text


def test_an_image_that_is_less_sharp_than_others_does_not_contradict(charuco):
    """Corners at 0.01 px, in one image at 0.1 px: it is used, with less weight."""
    rng = np.random.default_rng(0)
    lens = adjust_images(charuco.board, [BoardView("a", *charuco.board.find(one)) for one in charuco.images[:6]], SIZE).intrinsics
    views = []
    for k in range(8):
        T = se3.transform(se3.rotation_exp(0.4 * rng.normal(size=3)), np.array([-80.0, -60, 500]))
        ids = np.arange(len(charuco.board.points))
        uv = lens.project(se3.apply(T, charuco.board.points))[0]
        views.append(BoardView(str(k), ids, uv + (0.1 if k == 3 else 0.01) * rng.normal(size=uv.shape)))
    found = adjust_images(charuco.board, views, SIZE, lens)
    assert not found.contradicts.any()
    assert found.rms_px[3] == pytest.approx(0.1, rel=0.3)
    assert found.covariance[3, 0, 0] > 4 * np.median(found.covariance[:, 0, 0])


def test_intrinsics_of_another_mode_are_doubted(charuco, tmp_path):
    (tmp_path / "cameras.txt").write_text(COLMAP.replace("610.0", "630.0").replace("608.0", "628.0"))
    said = read(charuco, tmp_path / "a", tmp_path / "cameras.txt").sentences
    assert any(s.startswith("warning: other intrinsics than those of --camera fit the images better") for s in said)
    (tmp_path / "right.txt").write_text(COLMAP)
    assert not any("warning" in s for s in read(charuco, tmp_path / "b", tmp_path / "right.txt").sentences)


def test_an_error_of_the_intrinsics_moves_the_targets_as_the_set_says(charuco):
    views = [BoardView(str(i), *charuco.board.find(image)) for i, image in enumerate(charuco.images)]
    found = adjust_images(charuco.board, views, SIZE)
    for k in range(found.root.shape[1]):
        step = 0.5 * found.root[:, k]
        moved = adjust_images(charuco.board, views, SIZE, found.intrinsics.moved(-step))
        turn = se3.rotation_log(found.T[:, :3, :3] @ np.swapaxes(moved.T[:, :3, :3], 1, 2))
        change = np.concatenate([found.T[:, :3, 3] - moved.T[:, :3, 3], turn], axis=1)
        sigma = np.sqrt(np.einsum("iuu->iu", found.covariance))
        np.testing.assert_allclose(change / sigma, -0.5 * found.shared[:, :, k] / sigma, atol=0.15)


FILES = {
    "opencv.yaml": "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 600., 0., 320., 0., 601., "
    "240., 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ -0.1, 0.02, 0.001, "
    "0.002, 0. ]\nimage_width: 640\nimage_height: 480\n",
    "camera_info.yaml": "image_width: 640\nimage_height: 480\ncamera_name: cam\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [600, 0, 320, 0, "
    "601, 240, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.1, 0.02, 0.001, 0.002, 0]\n",
    "camchain.yaml": "cam0:\n  camera_model: pinhole\n  intrinsics: [600.0, 601.0, 320.0, 240.0]\n  distortion_model: radtan\n"
    "  distortion_coeffs: [-0.1, 0.02, 0.001, 0.002]\n  resolution: [640, 480]\n  rostopic: /cam0/image_raw\n",
    "cameras.txt": "# Camera list\n1 OPENCV 640 480 600 601 320.5 240.5 -0.1 0.02 0.001 0.002\n",
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_intrinsics_are_read_as_other_programs_write_them(name, tmp_path):
    (tmp_path / name).write_text(FILES[name])
    lens = read_intrinsics(tmp_path / name)
    np.testing.assert_array_equal(lens.values[:8], [600, 601, 320, 240, -0.1, 0.02, 0.001, 0.002])
    assert not lens.values[8:].any()
    assert lens.size == (640, 480)
    assert not lens.fisheye


def test_an_equidistant_lens_projects_by_the_angle(tmp_path):
    (tmp_path / "camchain.yaml").write_text(
        "cam0: {camera_model: pinhole, intrinsics: [500, 500, 320, 240], distortion_model: equidistant, "
        "distortion_coeffs: [0, 0, 0, 0], resolution: [640, 480]}\n"
    )
    lens = read_intrinsics(tmp_path / "camchain.yaml")
    uv, by_point, _ = lens.project(np.array([[1.0, 0, 1.0], [0.0, -2.0, 2.0]]))
    np.testing.assert_allclose(uv, [[320 + 500 * np.pi / 4, 240], [320, 240 - 500 * np.pi / 4]], atol=1e-6)
    np.testing.assert_allclose(by_point[0, 0], [250, 0, -250], atol=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "camera_matrix: 3",
        "cam0: {intrinsics: [1]}",
        "1 OPENCV 640 480 600",
        "a: [",
        "camera_matrix: {data: [0,0,0,0,0,0,0,0,1]}\nD: [0]",
    ],
)
def test_a_damaged_file_of_intrinsics_is_refused_in_a_sentence(text, tmp_path):
    (tmp_path / "camera.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"camera\.yaml"):
        read_intrinsics(tmp_path / "camera.yaml")


def test_what_images_lack_is_said(charuco, tmp_path):
    images, flange = write(charuco, tmp_path / "a")
    options = TableOptions(flange="vector")
    table = table_of(flange, options)
    (images / "view3.png").unlink()
    with pytest.raises(ConfigError, match="10 poses and 9 images"):
        read_images([images], table, charuco.board, None, options)
    with pytest.raises(ConfigError, match=r"0 of 9 images show the chessboard board of 9 x 6.*check --board, --size"):
        read_images([images], table.rows(np.arange(10) != 2), Board(kind="chessboard", columns=9, rows=6, pitch_mm=20), None, options)
    with pytest.raises(ConfigError, match="side of the markers is missing"):
        board_of("charuco", "8x6", 20)
    with pytest.raises(ConfigError, match="no dictionary '9X9_1'"):
        board_of("charuco", "8x6", 20, 15, "9X9_1")
    with pytest.raises(CalibrationError, match="3 image"):
        adjust_images(charuco.board, [BoardView("a", *charuco.board.find(charuco.images[0]))] * 3, SIZE)


def test_a_set_of_images_comes_back(charuco, tmp_path):
    obs = read(charuco, tmp_path / "a").observations
    mbcacq.recording.datasets.observation_set.write_observation_set(obs, tmp_path / "set")
    again = mbcacq.load_observations(tmp_path / "set")
    np.testing.assert_array_equal(again.shared, obs.shared)
    np.testing.assert_array_equal(again.images.root, obs.images.root)
    assert replace(again.images, root=obs.images.root, values=obs.images.values) == obs.images
