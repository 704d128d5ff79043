"""A small synthetic run as events: a six-axis arm looks at three balls from a few poses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbcacq.acquisition import events
from mbcacq.devices import Cycles, Scan

CELL = """\
format: mbcacq-observation-set/1
robot:                                   # a comment that must survive
  name: six axes
  repeatability_mm: 0.02
  links:
    - {sign: -1, theta_deg: 0, d_mm: 400, a_mm: 25, alpha_deg: -90, gear_ratio: 119.2, mass_kg: 20}
    - {sign: 1, theta_deg: 0, d_mm: 0, a_mm: 560, alpha_deg: 0, gear_ratio: 126.1, mass_kg: 15}
    - {sign: 1, theta_deg: -90, d_mm: 0, a_mm: 25, alpha_deg: -90, gear_ratio: 99.6, mass_kg: 10}
    - {sign: -1, theta_deg: 0, d_mm: 515, a_mm: 0, alpha_deg: 90, gear_ratio: 80, mass_kg: 5}
    - {sign: 1, theta_deg: 0, d_mm: 0, a_mm: 0, alpha_deg: -90, gear_ratio: 80.9, mass_kg: 3}
    - {sign: -1, theta_deg: 180, d_mm: 90, a_mm: 0, alpha_deg: 180, gear_ratio: 50.4, mass_kg: 1}
hand_eye: {abc_deg: [10, 20, 30], translation_mm: [1.5, -2.25, 240]}
artefacts:
  - id: mbc
    name: three balls
    balls:
      - {id: 1, centre_mm: [0, 0, 0], diameter_mm: 12}
      - {id: 2, centre_mm: [30, 0, 5], diameter_mm: 12}
      - {id: 7, centre_mm: [0, 40, -5], diameter_mm: 12}
stations:
  - {id: 1, artefact: mbc}
  - {id: far, artefact: mbc}
scanner: {name: made, noise_mm: [0.005, 0.005, 0.009]}
"""
PLAN = """\
format: mbcacq-plan/1
name: made
scanner:
  field_of_view: {near_z_mm: 10, far_z_mm: -25, near_half_mm: [33, 35], far_half_mm: [50, 50], body_mm: [[-60, -25, 164], [60, 25, 260]]}
"""
BALLS = np.array([1, 2, 7])


def start(n_poses: int = 4) -> events.RunStarted:
    return events.RunStarted(0.0, "made", "2026-01-02T03:04:05+00:00", PLAN, CELL, n_poses, {"mbcacq": "0", "numpy": "2"})


def cycles(rng: np.random.Generator, time_s: float, count: int = 10) -> Cycles:
    q = rng.normal(size=(count, 6))
    return Cycles(
        {
            "time_s": time_s + 0.004 * np.arange(count),
            "host_time_s": 1e4 + time_s + 0.004 * np.arange(count),
            "q": q,
            "q_set": q + 1e-4,
            "q_command": q + 2e-4,
            "current_percent": rng.normal(size=(count, 6)),
            "ipoc": np.arange(count) + 2**40,
            "delay": np.zeros(count, dtype=np.int32),
        }
    )


def scan(rng: np.random.Generator, points: int = 500) -> Scan:
    return Scan(
        points=rng.normal(size=(points, 3)).astype(np.float32),
        intensity=rng.integers(0, 256, points).astype(np.uint8),
        shape=(100, 50),
        pixel=rng.permutation(5000)[:points].astype(np.int32),
        time_s=12.5,
        frame=7,
        exposure_us=900.0,
        measurements={"width": 1.25},
    )


def pose(rng: np.random.Generator, number: int, time_s: float, points: int = 500) -> Iterator[events.Event]:
    """Everything that happens at one pose."""
    station = "1" if number % 2 == 0 else "far"
    about = (number, station, "position", "look around")
    q = rng.normal(size=6)
    direction = rng.integers(-1, 2, 6)
    yield events.StateChanged(time_s, "moving")
    yield events.CyclesReceived(time_s + 0.05, cycles(rng, time_s))
    yield events.PoseReached(time_s + 0.1, *about, q, direction, time_s + 0.04)
    yield events.StateChanged(time_s + 0.1, "scanning")
    for exposure in range(2):
        yield events.ScanTaken(time_s + 0.2, number, exposure, scan(rng, points))
        yield events.CentresFound(time_s + 0.25, number, exposure, BALLS, rng.normal(size=(3, 3)), np.full(3, 150), rng.random(3))
    found = BALLS if number % 3 else BALLS[:2]
    k = len(found)
    yield events.PoseDone(
        time_s + 0.3,
        *about,
        q=q + 1e-9 * rng.normal(size=6),
        direction=direction,
        robot_time_s=time_s + 0.04 + rng.random(),
        ball=found,
        xyz=40 * rng.normal(size=(k, 3)),
        n_points=rng.integers(100, 200, k),
        rms_mm=rng.random(k),
        scatter_mm=rng.random((k, 3)),
        n_exposures=2,
        current=rng.normal(size=6),
        sensors={"air_C": 20 + rng.random(), "humidity_percent": 45.5},
    )


def run(seed: int = 0, n_poses: int = 4, points: int = 500) -> Iterator[events.Event]:
    """A whole run."""
    rng = np.random.default_rng(seed)
    yield start(n_poses)
    yield events.StateChanged(0.01, "connecting")
    yield events.Message(0.02, "info", "robot: made up")
    yield events.StepStarted(0.03, 0, "look around", n_poses)
    yield events.StationReached(0.04, "1", "mbc")
    for number in range(n_poses):
        yield from pose(rng, number, 1.0 + number, points)
    yield events.HealthReceived(n_poses + 1.5, "scanner", {"temperature_C": 40.5, "uptime s": 3.0})
    yield events.StateChanged(n_poses + 2.0, "stopped")
    yield events.RunStopped(n_poses + 2.0, "success", "all poses measured")
