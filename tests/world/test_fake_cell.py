"""The fake cell as a whole, through its sockets: as drivers reach it, its faults, and that nothing remains after it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mbcacq_fakes.cell.fake_cell import FakeCell
from mbcacq_fakes.world.arm import TrueArm
from mbcacq_fakes.world.rigid import carry, invert
from small_cell import BALLS, HAND_EYE, POSE_STATION, facts, fit_sphere, poses_q

from mbcacq.devices import ConfigError, ConnectError, MotionLimits, create
from mbcacq.model import cell as cells
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.schema import Plan

LIMITS = MotionLimits(np.full(6, 2.0), np.full(6, 8.0), np.full(6, 80.0), settle_s=0.05)
LINKS = [(-1, 0, 400, 25, -90), (1, 0, 0, 560, 0), (1, -90, 0, 25, -90), (-1, 0, 515, 0, 90), (1, 0, 0, 0, -90), (-1, 180, 90, 0, 0)]
VIEW = {"near_z_mm": 55, "far_z_mm": -55, "near_half_mm": (35.5, 49), "far_half_mm": (50, 77)}

needs_signals = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL and no /proc")


def loaded(**plan):
    stations = facts().station_pose
    document = {
        "format": "mbcacq-plan/1",
        "name": "small",
        "robot": {"driver": "kuka_rsi", "model": "-", "home_deg": np.degrees(poses_q()[0]).tolist()},
        "scanner": {
            "driver": "gocator",
            "model": "3210",
            "options": {"address": "127.0.0.1"},
            "field_of_view": VIEW,
            "exposure_us": 8000.0,
        },
        "hand_eye": {"rotation": HAND_EYE[:3, :3].tolist(), "translation_mm": HAND_EYE[:3, 3].tolist()},
        "artefacts": ["-"],
        "stations": [
            {
                "id": k + 1,
                "artefact": "mbc" if k < 2 else "bar",
                "pose_in_base": {"rotation": T[:3, :3].tolist(), "translation_mm": T[:3, 3].tolist()},
            }
            for k, T in enumerate(stations)
        ],
        "steps": [{"name": "s", "phase": "position", "do": "joints", "station": 1, "poses_deg": [[0.0] * 6]}],
    }
    plan = Plan.model_validate({**document, **plan})
    links = [
        {"sign": s, "theta_deg": t, "d_mm": d, "a_mm": a, "alpha_deg": al, "limits_deg": (-350, 350), "speed_deg_s": 300}
        for s, t, d, a, al in LINKS
    ]
    robot = RobotSpec.model_validate({"name": "KR 10", "links": links}).model()
    artefacts = (
        cells.Artefact("mbc", "", tuple(range(1, 9)), BALLS, np.full(8, 12.0)),
        cells.Artefact("bar", "", (9, 10), np.array([[-30.0, 0, 0], [30.0, 0, 0]]), np.full(2, 25.0)),
    )
    stations = tuple(cells.Station(str(s.id), s.artefact, s.pose_in_base.transform()) for s in plan.stations)
    cell = cells.Cell(robot, plan.hand_eye.transform(), artefacts, stations)
    poses = [
        PlannedPose(
            number=k,
            step=0,
            step_name="s",
            phase="position",
            station=str(s + 1),
            artefact="mbc" if s < 2 else "bar",
            q=q,
            balls=(),
            exposures=1,
            line=1,
        )
        for k, (q, s) in enumerate(zip(poses_q(), POSE_STATION, strict=True))
    ]
    return LoadedPlan(Path("small.yaml"), plan, cell, "", {}), poses


def drivers(cell, plan, **scanner):
    o = cell.overrides()
    limits = {"limits_deg": [(-350, 350)] * 6}
    robot = create("robots", "kuka_rsi", "KR 10", {**limits, **plan.robot.options, **o["robot"]})
    return robot, create("scanners", "gocator", "3210", {**plan.scanner.options, **o["scanner"], **scanner})


def go(robot, q):
    robot.move_to(q, LIMITS)
    deadline = time.monotonic() + 1000
    while not robot.state().arrived:
        assert time.monotonic() < deadline
        time.sleep(0.002)


def test_a_driven_cell_shows_the_truth():
    """Through RSI and the Gocator protocol: balls appear where the true cell has them, at every station."""
    plan, poses = loaded()
    with FakeCell(plan, poses, seed=2) as cell:
        truth = cell.truth()
        true_arm = TrueArm.from_rows(facts().sign, facts().rows + truth["errors"])
        robot, scanner = drivers(cell, plan.plan)
        with robot, scanner:
            for pose in (poses[0], poses[3]):
                go(robot, pose.q)
                points = scanner.capture().points.astype(float)
                T = invert(true_arm.flange(robot.state().q[None])[0] @ truth["T_flange_scanner"]) @ truth["T_base_station"][pose.station]
                for centre in carry(T, np.array([truth["balls"][b] for b in range(1, 9)])):
                    near = points[np.linalg.norm(points - centre, axis=1) < 6.4]
                    # scanner noise 5, 5, 9 um, and 5 urad of each joint over up to a metre
                    assert np.linalg.norm(fit_sphere(near, 6.0)[0] - centre) < 0.06


def test_mishaps_and_scanner_faults_reach_the_running_cell():
    plan, poses = loaded()
    with FakeCell(plan, poses) as cell:
        robot, scanner = drivers(cell, plan.plan, timeout_s=3.0)
        with robot, scanner:
            go(robot, poses[0].q)
            full = len(scanner.capture().points)
            cell.faults.mishap("hidden_ball", ball=1)
            assert len(scanner.capture().points) < 0.95 * full
            cell.faults.scanner("no_data", times=1)
            with pytest.raises(TimeoutError):
                scanner.capture()
            with pytest.raises(ConfigError, match="no ball '99'"):
                cell.faults.mishap("hidden_ball", ball=99)


def test_a_modbus_positioner_and_sensor_are_played_at_the_wire():
    position, flag = {"address": 0, "type": "float32"}, {"address": 0, "table": "discrete"}
    air = {"address": 7, "type": "int16", "scale": 0.1}
    plan, poses = loaded(
        positioner={
            "driver": "modbus",
            "options": {
                "host": "10.0.0.9",
                "stations": {1: 0.0, 2: 50.0, 3: 90.0},
                "position": position,
                "in_position": flag,
                "flag_delay_s": 0.03,
            },
        },
        sensors=[
            {"driver": "modbus", "options": {"host": "10.0.0.8", "values": {"air_C": air}}},
            {"driver": "serial", "options": {"port": "/dev/ttyUSB0", "line": r"T=\s*(?P<robot_C>[-0-9.]+) C"}},
        ],
        fake={"climate": {"air_C": 25.5, "air_drift_K": 0.0, "warmup_K": 0.0}},
    )
    with FakeCell(plan, poses) as cell:
        o, use = cell.overrides(), plan.plan
        positioner = create("positioners", "modbus", "", {**use.positioner.options, **o["positioner"]})
        sensors = [create("sensors", s.driver, "", {**s.options, **o[f"sensor {k + 1}"]}) for k, s in enumerate(use.sensors)]
        robot, scanner = drivers(cell, use)
        with robot, scanner, positioner, sensors[0], sensors[1]:
            go(robot, poses[0].q)
            assert len(scanner.capture().points) == 0  # nobody has driven anywhere yet
            positioner.go_to("1", "")
            assert len(scanner.capture().points) > 9000
            assert sensors[0].read() == pytest.approx({"air_C": 25.5})
            assert sensors[1].read() == pytest.approx({"robot_C": 25.5})


def running(process_id):
    try:
        return Path(f"/proc/{process_id}/stat").read_text().split(")")[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def gone(process_ids, seconds=100.0):
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if not any(map(running, process_ids)):
            return True
        time.sleep(0.05)
    return False


def children(process_id):
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            if int(stat.read_text().rsplit(")", 1)[1].split()[1]) == process_id:
                found.append(int(stat.parent.name))
        except (OSError, IndexError):
            continue
    return found


@needs_signals
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc to see processes")
def test_a_killed_parent_leaves_no_orphans():
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); from test_fake_cell import *; plan, poses = loaded(); c = FakeCell(plan, poses).start();"
        "print('up', flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, str(Path(__file__).parent)], stdout=subprocess.PIPE, text=True)
    with parent:
        assert parent.stdout.readline() == "up\n"
        family = children(parent.pid)
        assert len(family) >= 2
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
    assert gone(family)


@needs_signals
def test_a_dead_world_is_a_named_error_and_stop_still_works():
    plan, poses = loaded()
    with FakeCell(plan, poses) as cell:
        assert cell.alive()
        os.kill(cell.process_id, signal.SIGKILL)
        deadline = time.monotonic() + 600.0
        while cell.alive() and time.monotonic() < deadline:
            time.sleep(0.02)
        assert not cell.alive()
        with pytest.raises(ConnectError, match="process has ended"):
            cell.ask("truth")
        cell.stop()
        cell.stop()


def test_a_dry_run_is_of_this_computer_whatever_controller_the_plan_names():
    options = {"bind": "0.0.0.0", "controller_ip": "192.0.2.7"}
    plan, poses = loaded(robot={"driver": "kuka_rsi", "model": "-", "options": options, "home_deg": np.degrees(poses_q()[0]).tolist()})
    with FakeCell(plan, poses, seed=1) as cell:
        robot, _ = drivers(cell, plan.plan)
        with robot:
            assert np.isfinite(robot.state().q).all()


def test_what_the_fake_cell_cannot_play_is_said_at_once():
    plan, poses = loaded(fake={"hiden": []})
    with pytest.raises(ConfigError, match="fake.hiden"):
        FakeCell(plan, poses)
    for driver, given, said in (
        ("kuka_eki", {"moving": []}, "moving is of an arm driven by kuka_rsi"),
        ("kuka_rsi", {"rearm": 1}, "unknown option rearm"),
        ("kuka_eki", {"layout": "motion"}, "unknown option layout"),
    ):
        robot = {"driver": driver, "model": "-", "home_deg": np.degrees(poses_q()[0]).tolist()}
        plan, poses = loaded(robot=robot, fake={"robot": given})
        with pytest.raises(ConfigError, match=said):
            FakeCell(plan, poses)
    plan, poses = loaded(scanner={"driver": "gocator", "options": {"address": "192.0.2.7"}, "field_of_view": VIEW})
    with pytest.raises(ConfigError, match=r"192\.0\.2\.7.*127\.0\.0\.1"):
        FakeCell(plan, poses, ports="plan").start()
