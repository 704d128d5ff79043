"""Hand-eye calibration view by view: poses as people write them, what views are worth, and the command itself."""

import threading
import time

import numpy as np
import pytest
from click.testing import CliRunner

pytest.importorskip("cv2")
import cv2
from rendered_boards import BOARDS, DISTORTION, SIZE, K, make, write

import mbcacq
from mbcacq.camera.adjustment import BoardView, adjust_images
from mbcacq.camera.intrinsics import Intrinsics
from mbcacq.camera.next_view import _columns, next_view
from mbcacq.cli.app import app
from mbcacq.devices import RobotState
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.workflow.view_sources import FollowedArm, ImageFolder, pose_of_text

ALONE = mbcacq.CalibrationOptions(kinematics=False)
LENS = Intrinsics(K[[0, 1], [0, 1]], K[:2, 2], DISTORTION)
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # 90 deg about z
CHARUCO = ["--board", "charuco", "--size", "8x6", "--pitch", "20", "--inner", "15", "--dictionary", "4X4_50"]


@pytest.mark.parametrize(("text", "convention"), [
    ("p[0.1, -0.2, 0.3, 0, 0, 1.5707963267948966]", "ZYX"),  # as a Universal Robot writes it, whatever was said
    ("{X 100.0, Y -200.0, Z 300.0, A 90.0, B 0.0, C 0.0}", "ZYX"),  # KUKA
    ("X=100,0 Y=-200,0 Z=300,0 A=90,0 B=0,0 C=0,0", "ZYX"),  # decimal commas
    ("100,0; -200,0; 300,0; 90,0; 0,0; 0,0", "ZYX"),
    ("100,-200,300,0,0,90", "xyz"),  # FANUC: W, P, R
    ("100 -200 3e2 0 0 1.5707963267948966", "vector"),
    ("100.0 -200.0 300.0 0.7071067811865476 0 0 0.7071067811865476", "wxyz"),  # ABB
    ("0 -1 0 100  1 0 0 -200  0 0 1 300  0 0 0 1", "ZYX"),
])  # fmt: skip
def test_a_pose_is_read_as_a_pendant_shows_it(text, convention):
    T = pose_of_text(text, convention)
    np.testing.assert_allclose(T[:3, 3], [100, -200, 300], atol=1e-9)
    np.testing.assert_allclose(T[:3, :3], QUARTER, atol=1e-9)


@pytest.mark.parametrize(("text", "said"), [
    ("100 200 300 0 0", "5 numbers, and 6 are expected"),
    ("100 200 300 0 0 90", "longer than a whole turn"),
    ("", "0 numbers"),
])  # fmt: skip
def test_what_is_no_pose_is_refused(text, said):
    with pytest.raises(ConfigError, match=said):
        pose_of_text(text, "vector")


def test_derivatives_of_a_view_are_those_of_its_definition():
    rng = np.random.default_rng(3)
    T = se3.transform(se3.rotation_exp(rng.normal(size=3)), np.array([20.0, -30, 300]))
    for k in range(12):
        step = 1e-6 * (np.arange(12) == k)
        moved = se3.inverse(se3.exp(step[None, :6])[0]) @ T @ se3.exp(step[None, 6:])[0]
        change = np.r_[moved[:3, 3] - T[:3, 3], se3.rotation_log(moved[:3, :3] @ T[:3, :3].T)] / 1e-6
        np.testing.assert_allclose(_columns(T[None])[0, :, k], change, atol=1e-3 if k in (3, 4, 5) else 1e-5)


def test_after_views_that_turn_about_one_axis_another_axis_is_asked_for():
    board = BOARDS["charuco"]
    middle = board.points.max(axis=0) / 2
    views = []
    for angle in np.linspace(-0.6, 0.6, 5):
        R = se3.rotation_exp(np.array([0.0, angle, 0.0]))
        T = se3.transform(R, np.array([0.0, 0, 300]) - R @ middle)
        views.append(BoardView(str(angle), np.arange(len(board.points)), LENS.project(se3.apply(T, board.points))[0]))
    seen = adjust_images(board, views, SIZE, LENS)
    asked = next_view(board, SIZE, LENS, seen)
    turns = se3.rotation_log(asked.T[:3, :3] @ np.swapaxes(seen.T[:, :3, :3], 1, 2))
    assert np.hypot(turns[:, 0], turns[:, 2]).min() > np.radians(30)
    # What a person refuses is not asked for again, nor is a view like it.
    other = next_view(board, SIZE, LENS, seen, [asked.T])
    assert np.linalg.norm(se3.rotation_log(other.T[:3, :3] @ asked.T[:3, :3].T)) > np.radians(24)


def test_words_of_a_view_say_where_the_camera_is():
    board = BOARDS["charuco"]
    first = next_view(board, SIZE, LENS, None)
    assert first.in_words().startswith("look straight at the board, ")
    assert first.in_words().endswith("upright")
    # A camera to the right of the board and above it, which was rolled anticlockwise: the board appears turned clockwise.
    camera = np.array([200.0, -200.0, -300.0])
    z = -camera / np.linalg.norm(camera)
    x = np.cross(np.array([0.0, 1, 0]), z)
    x /= np.linalg.norm(x)
    upright = np.stack([x, np.cross(z, x), z])  # rows: axes of the camera in the board's frame
    R = se3.rotation_exp(np.array([0.0, 0.0, np.pi / 3])) @ upright
    view = type(first)(board, se3.transform(R, -R @ (camera + board.points.max(axis=0) / 2)), first.outline)
    words = view.in_words()
    assert "from 43° off straight, from right and above, 412 mm away" in words
    assert words.endswith("clockwise in the image")
    assert "anticlockwise" not in words


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    cell = make("charuco", np.random.default_rng(6), poses=9)
    return cell, *write(cell, tmp_path_factory.mktemp("live"))


def lines_of(cell):
    return ["p[" + ", ".join(map(repr, [*(row[:3] / 1e3).tolist(), *row[3:].tolist()])) + "]" for row in cell.flange]


def test_poses_are_pasted_until_the_place_is_known(measured, tmp_path):
    cell, images, _ = measured
    lines = lines_of(cell)
    lines[2:2] = ["1 2 3", "n"]  # a line that is no pose, and a view out of reach
    done = CliRunner().invoke(
        app,
        ["hand-eye", "--images", str(images), *CHARUCO, "--flange", "ur", "--enough", "0.6", "--out", str(tmp_path / "out")],
        input="\n".join(lines) + "\n",
    )
    assert done.exit_code == 0, done.output
    assert "'1 2 3' is no pose: 3 numbers" in done.output
    assert "4 more before" not in done.output.split("view 5:")[1]
    assert "view 9: look" not in done.output  # eight were enough
    page = (tmp_path / "out" / "index.html").read_text()
    assert "Enough: x, y and z are known within 0.6 mm." in page
    assert 'http-equiv="refresh"' not in page
    assert cv2.imread(str(tmp_path / "out" / "view.jpg")).shape[:2] == SIZE[::-1]
    # Its folder is what `data new` reads, and the truth is within what is stated.
    set_of = [str(tmp_path / "out" / "images"), "--poses", str(tmp_path / "out" / "poses.csv"), *CHARUCO, "--out", str(tmp_path / "again")]
    again = CliRunner().invoke(app, ["data", "new", *set_of])
    assert again.exit_code == 0, again.output
    live, read = (mbcacq.calibrate(mbcacq.load_observations(tmp_path / name), ALONE) for name in ("out/set", "again"))
    np.testing.assert_allclose(read.state.T_flange_scanner, live.state.T_flange_scanner, atol=1e-4)
    assert np.abs(se3.inverse(cell.X) @ live.state.T_flange_scanner - np.eye(4))[:3, 3].max() < 0.6


def test_poses_of_a_file_end_with_what_is_known(measured, tmp_path):
    _, images, flange = measured
    done = CliRunner().invoke(app, [
        "hand-eye", "--images", str(images), *CHARUCO, "--poses", str(flange), "--flange", "vector", "--enough", "0.001", "--wait", "0",
        "--out", str(tmp_path / "out"),
    ])  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "9 views" in done.output
    assert "more than the 0.001 mm that were asked for" in done.output


def test_what_is_missing_is_said(tmp_path):
    for said, text in (
        (["--device", "0"], "--board, --size, --pitch: missing"),
        ([*CHARUCO, "--flange", "ur"], "give the images' --images FOLDER"),
        (["--images", str(tmp_path), *CHARUCO], "--flange CONVENTION is missing"),
        (["--device", str(tmp_path / "none%d.png"), *CHARUCO, "--flange", "ur"], "OpenCV opens no camera"),
        (["--images", str(tmp_path), *CHARUCO, "--follow", "kuka"], "its arm is moved by this program"),
    ):
        done = CliRunner().invoke(app, ["hand-eye", *said, "--out", str(tmp_path / "out")])
        assert done.exit_code not in (0, 1), done.output
        assert text in done.output


class _Arm:
    """An arm that somebody moves from stand to stand."""

    def __init__(self, stands):
        self.stands, self.time_s = stands, 0.0

    def state(self):
        self.time_s += 0.02
        k, part = divmod(self.time_s / 2.5, 1.0)  # 2 s at each stand, and half a second on the way
        a, b = (self.stands[min(int(k) + j, len(self.stands) - 1)] for j in (0, 1))
        share = max(0.0, (part - 0.8) / 0.2)
        return RobotState(self.time_s, a + share * (b - a), 0 < share < 1, True)


def test_a_followed_arm_counts_where_it_stands():
    stands = np.radians([[0.0, 10, 20], [30, 10, 20], [30, 50, 20]])
    source = FollowedArm(_Arm(stands))
    for q in stands:
        np.testing.assert_array_equal(source.next(lambda: True), q)
    assert source.next(lambda: False) is None  # it stays where it is


def test_an_image_that_is_still_being_written_is_waited_for(tmp_path):
    image = np.full((48, 64), 90, np.uint8)
    whole = cv2.imencode(".png", image)[1].tobytes()
    (tmp_path / "a.png").write_bytes(whole[:40])
    writer = threading.Timer(0.1, lambda: (tmp_path / "a.png").write_bytes(whole))
    writer.start()
    found = ImageFolder(tmp_path).next(lambda: time.sleep(0.05) is None)
    writer.join()
    np.testing.assert_array_equal(found, image)
