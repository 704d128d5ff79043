"""A scanner without a fake at the wire: the plan's noise, view, resolution and scan time are those of its dry run."""

import numpy as np
import pytest
import yaml
from dry_runs import recorded
from mbcacq_fakes.cell.fake_cell import FakeCell
from mbcacq_fakes.cell.simulated_scanner import SimulatedScanner
from mbcacq_fakes.world.description import ScannerView
from mbcacq_fakes.world.noise import NoiseGrowth
from mbcacq_fakes.world.scanner import Optics

import mbcacq
from mbcacq.devices import ConfigError
from mbcacq.model import shipped
from mbcacq.plan import expand, load

VIEW = {"near_z_mm": 55, "far_z_mm": -55, "near_half_mm": [35.5, 49], "far_half_mm": [50, 77]}
IN_CAMERA = {"near_z_mm": -384, "far_z_mm": -520, "near_half_mm": [130, 100], "far_half_mm": [180, 135]}


def plan_with(folder, scanner, robot_driver="not_installed", **more):
    robot = {"driver": robot_driver, "model": str(shipped.robot_file("kr10_r1100_2")), "home_deg": [0, -90, 90, 0, 90, 0]}
    content = {
        "format": "mbcacq-plan/1",
        "name": "any scanner",
        "robot": robot,
        "scanner": {"driver": "photoneo", "field_of_view": VIEW, **scanner},
        "hand_eye": {"rotation": [[0, -1, 0], [-1, 0, 0], [0, 0, -1]], "translation_mm": [0, 0, 265]},
        "artefacts": [str(shipped.folder() / "artefacts" / "mbc-8.yaml")],
        "stations": [{"id": "p1", "artefact": "mbc", "pose_in_base": {"translation_mm": [600, 0, 150]}}],
        "exposures": 4,
        "steps": [
            {
                "name": "views",
                "phase": "orientation",
                "do": "look",
                "stations": ["p1"],
                "views": [{"tilt_deg": 20, "azimuth_deg": a, "roll_deg": r} for a, r in ((0, 0), (120, 30), (240, -30))],
            }
        ],
        **more,
    }
    path = folder / "plan.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def scatter(path, folder):
    """(3,) mm standard deviation of a centre between the exposures of a pose, and what was recorded."""
    heard = []
    found = recorded(path, folder, [heard.append])
    poses = [event for event in heard if type(event).__name__ == "PoseDone"]
    return np.sqrt(np.mean(np.concatenate([p.scatter_mm for p in poses]) ** 2, axis=0)), found, poses


def test_a_dry_run_has_the_noise_that_the_plan_states(tmp_path):
    quiet, *_ = scatter(plan_with(tmp_path, {"noise_mm": [0.005, 0.005, 0.009]}), tmp_path / "a")
    noisy, *_ = scatter(plan_with(tmp_path, {"noise_mm": [0.05, 0.05, 0.09]}), tmp_path / "b")
    assert quiet == pytest.approx([0.005, 0.005, 0.009], rel=0.4)
    assert noisy == pytest.approx([0.05, 0.05, 0.09], rel=0.4)


def test_the_fakes_at_the_wire_take_it_too(tmp_path):
    sensor = {"driver": "gocator", "noise_mm": [0.03, 0.03, 0.05], "options": {"address": "127.0.0.1"}}
    noisy, *_ = scatter(plan_with(tmp_path, sensor), tmp_path / "a")
    assert noisy == pytest.approx([0.03, 0.03, 0.05], rel=0.4)


def test_what_the_fake_section_says_wins(tmp_path):
    path = plan_with(tmp_path, {"noise_mm": [0.05, 0.05, 0.09]}, fake={"noise_mm": [0.0, 0.0, 0.0], "speckle_mm": 0.0})
    assert scatter(path, tmp_path / "a")[0] == pytest.approx([0, 0, 0], abs=2e-3)


def test_a_scanner_whose_frame_is_in_its_camera_is_aimed_by_the_middle_of_its_view(tmp_path):
    away = {"rotation": [[0, -1, 0], [-1, 0, 0], [0, 0, -1]], "translation_mm": [0, 0, -180]}
    path = plan_with(tmp_path, {"field_of_view": IN_CAMERA, "noise_mm": [0.01, 0.01, 0.02]}, hand_eye=away, exposures=1)
    _, found, poses = scatter(path, tmp_path / "a")
    assert [p.xyz[:, 2].mean() for p in poses] == pytest.approx([-452] * 3, abs=8)
    assert found.n_poses == 3


def test_an_exposure_takes_the_plan_s_scan_time_on_the_simulated_clock(tmp_path):
    def duration(scan_time_s):
        *_, poses = scatter(plan_with(tmp_path, {"scan_time_s": scan_time_s}, exposures=2), tmp_path / f"{scan_time_s}")
        return poses[2].robot_time_s - poses[0].robot_time_s

    assert duration(5.0) - duration(0.0) == pytest.approx(2 * 2 * 5.0, abs=0.2)


def test_points_lie_as_far_apart_as_the_plan_says(tmp_path):
    path = plan_with(tmp_path, {"resolution_mm": 0.5})
    loaded = load(path)
    with FakeCell(loaded, expand(loaded)) as cell:
        frame = cell.overrides()["scanner"]["expose"](0.0)
    assert frame.xyz.shape[:2] == (252, 171)  # (49 + 77) and (35.5 + 50) mm by 0.5


def test_noise_grows_with_distance_and_slant_where_stated():
    growth = NoiseGrowth.stated(ScannerView(), (0.01, 0.01, 0.02), (0.02, 0.02, 0.06), 4.0)
    assert growth.factors(np.array([0.0, -55.0, 55.0]), np.ones(3)) == pytest.approx(np.array([[1, 2, 0.5], [1, 2, 0.5], [1, 3, 1 / 3]]))
    assert growth.factors(np.array([0.0]), np.array([0.5])) == pytest.approx(np.full((3, 1), 4.0))
    assert NoiseGrowth.stated(ScannerView(), (0.01, 0.01, 0.02), None, 1.0).factors(np.array([-55.0]), np.array([0.3])) == pytest.approx(
        1.0
    )


def test_the_projector_stands_where_the_view_s_edges_meet():
    view = ScannerView(-100.0, -200.0, np.array([50.0, 50.0]), np.array([100.0, 100.0]))  # a pyramid with its tip at z = 0
    assert Optics.above(view).lamp == pytest.approx([0, 100 / 3, 0])


def test_a_real_run_refuses_it_and_an_unknown_driver_before_anything_long(tmp_path):
    with pytest.raises(ConfigError, match="there in a dry run only"):
        SimulatedScanner("scanner", "", {}).connect()
    path = plan_with(tmp_path, {}, "kuka_rsi")
    with pytest.raises(ConfigError, match="no driver 'photoneo' among the scanners"):
        mbcacq.run(path)


def test_fakes_of_a_scanner_without_one_point_to_the_dry_run(tmp_path):
    loaded = load(plan_with(tmp_path, {}))
    with pytest.raises(ConfigError, match="no fake of a scanner 'photoneo' at the wire.*--dry-run"):
        FakeCell(loaded, expand(loaded), ports="plan")


def test_a_positioner_of_another_driver_is_a_person_in_a_dry_run(tmp_path):
    path = plan_with(tmp_path, {}, positioner={"driver": "turntable", "options": {"address": "10.0.0.3"}}, exposures=1)
    assert recorded(path, tmp_path / "run").n_poses == 3
