"""One small calibration with a known truth, as its result file."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import verify
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations

sys.path.insert(0, str(Path(__file__).parent))

CHAIN = Chain(
    np.array([-1, 1, 1, -1, 1, -1.0]),
    np.radians([0, 0, -90, 0, 0, 180]),
    np.array([400, 0, 0, 420, 0, 80.0]),
    np.array([25, 455, 35, 0, 0, 0.0]),
    np.radians([-90, 0, -90, 90, -90, 180]),
    np.zeros(6),
)


def observed():
    """150 random postures around three placements of an eight-ball artefact; noise 5 um, joints repeat within 5 urad."""
    rng = np.random.default_rng(7)
    robot = RobotModel("small", CHAIN, np.radians([[-170, 170]] * 6), np.zeros(6), np.zeros((6, 3)), repeatability_mm=0.02)
    balls = np.array([[x, y, z] for x in (-40, 35) for y in (-30, 38) for z in (-12, 15)]) + rng.uniform(-6, 6, (8, 3))
    artefact = Artefact("mbc", "MBC", tuple(range(1, 9)), balls, np.full(8, 12.0))
    bar = Artefact("bar", "bar", (9, 10), np.array([[-300.0, 0, 0], [300, 0, 0]]), np.full(2, 25.0))
    T_hand = se3.from_abc(np.array([5.0, -3, 265]), np.radians([12.0, 3, 178]))
    stations = tuple(Station(f"s{i}", "mbc") for i in range(3)) + (Station("b1", "bar"),)
    cell = Cell(
        robot, se3.from_abc(np.array([0.0, 0, 260]), np.radians([10.0, 0, 180])), (artefact, bar), stations, noise_mm=np.full(3, 0.005)
    )
    truth = CHAIN.with_errors(
        np.array(
            [
                [0, 0, 0.1, 1e-4, 0],
                [2e-4, 0, -0.2, 1e-4, 1e-4],
                [-2e-4, 0.1, 0.05, -1e-4, 0],
                [1e-4, 0.1, 0.02, 5e-5, 0],
                [3e-4, -0.1, 0, 1e-4, 0],
                [0, 0, 0, 0, 0],
            ]
        )
    )
    q0 = np.radians([[0, -70, 100, 10, 40, 0], [35, -50, 80, -20, 50, 60], [-40, -90, 110, 30, 30, -80]])
    q, station, phase, pose, ball, xyz = [], [], [], [], [], []
    stations_in_base = [truth.flange(one[None])[0] @ T_hand for one in q0]
    stations_in_base.append(stations_in_base[0] @ se3.from_abc(np.array([0.0, 0, -20]), np.zeros(3)))
    for k in range(156):
        s = k % 3 if k < 150 else 3
        angles = q0[s % 3] + rng.normal(0, 0.12, 6)
        T = truth.flange((angles + rng.normal(0, 5e-6, 6))[None])[0] @ T_hand
        c = se3.apply(se3.inverse(T) @ stations_in_base[s], balls if s < 3 else bar.centres)
        visible = np.arange(8) if s < 3 else np.array([8, 9])
        q.append(angles)
        station.append(s)
        phase.append("position" if s < 3 else "verification")
        pose.extend([k] * len(visible))
        ball.extend(visible)
        xyz.extend(c + rng.normal(0, 0.005, c.shape))
    return (
        Observations(
            cell, np.arange(156), np.array(station), np.array(q), np.array(pose), np.array(ball), np.array(xyz), phase=np.array(phase)
        ),
        truth,
        T_hand,
    )


@pytest.fixture(scope="session")
def solved():
    observations, truth, T_hand = observed()
    calibration = calibrate(observations)
    result = calibration.to_dict()
    result["verification"] = verify(observations, calibration, limit_mm=0.1).to_dict()
    return json.loads(json.dumps(result)), observations, truth, T_hand


@pytest.fixture
def result_file(solved, tmp_path):
    path = tmp_path / "result.json"
    path.write_text(json.dumps(solved[0]))
    return path
