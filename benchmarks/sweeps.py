"""Line profiles on the move: hand-eye transform, sphere and clock against their stated uncertainty, with and without a wire.

    python benchmarks/sweeps.py [--cells 8]

Each cell has eight lines across one ball of 30 mm, run forth and back, 1 mm from profile to profile, points of 20 um, cycles of 4 ms that
err by 10 um. NEES is the squared error in stated standard deviations, 1 where these are right.
"""

from __future__ import annotations

import argparse

import bench  # noqa: F401  # before the simulated cells of the tests
import numpy as np
from sweep_data import RADIUS, coordinates, sweeps

from mbcacq.calibration.profile_clock import SeenSections, adjust_in_motion, start_in_motion
from mbcacq.geometry import se3
from mbcacq.geometry.motion_in_time import FlangeMotion
from mbcacq.spheres.circles import circles_in

DELAY, WIRE_S, DRIFT = 0.0173, 2e-5, 2e-5
NAMED = [0, 1, 2, 3, 4, 5, 6, 8, 9, 10]  # transform, delay, sphere


def cell(seed: int, wire: bool, **conditions: float):
    """Error (10,) and covariance of transform, delay and sphere, and the error (3,) mm of a sphere fitted to an assembled cloud."""
    made = sweeps(np.random.default_rng(seed), delay=DELAY, drift=DRIFT, **conditions)
    circles, noise = circles_in(made.points, RADIUS)
    keep = np.array([c is not None for c in circles])
    count = int(keep.sum())
    seen = SeenSections(made.profile_s[keep], np.zeros(count, int), np.full(count, RADIUS), [c for c in circles if c], noise)
    motion = FlangeMotion.of_poses(made.cycle_s, coordinates(made))
    known = DELAY + WIRE_S * np.random.default_rng([seed, 1]).standard_normal(), WIRE_S
    found = adjust_in_motion(motion, seen, start_in_motion(motion, seen), known if wire else None)
    delay = DELAY + DRIFT * (found.clock.epoch_s + DELAY - made.epoch_s)
    turn = se3.rotation_log(made.T_hand_eye[:3, :3].T @ found.T_hand_eye[:3, :3])
    off = found.T_hand_eye[:3, 3] - made.T_hand_eye[:3, 3]
    error = np.r_[off, turn, found.clock.delay_s - delay, found.spheres[0] - made.sphere]
    return error, found.covariance[np.ix_(NAMED, NAMED)], assembled(made, motion, seed)


def assembled(made, motion: FlangeMotion, seed: int) -> np.ndarray:
    """What users do: points of all profiles by the nominal transform (off by 1.5 mm and 0.4 deg) and the stamps as they are, one sphere."""
    rng = np.random.default_rng([seed, 2])
    nominal = made.T_hand_eye @ se3.exp(np.r_[1.5 * rng.standard_normal(3), np.radians(0.4) * rng.standard_normal(3)])
    T = motion.at(made.profile_s)[0] @ nominal
    cloud = np.concatenate([se3.apply(t, np.column_stack([p[:, 0], 0 * p[:, 0], p[:, 1]])) for t, p in zip(T, made.points, strict=True)])
    centre = cloud.mean(axis=0)
    for _ in range(20):
        away = cloud - centre
        distance = np.linalg.norm(away, axis=1)
        centre = centre + np.linalg.lstsq(away / distance[:, None], distance - RADIUS, rcond=None)[0]
    return centre - made.sphere


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=8, help="of each row")
    cells = parser.parse_args().cells
    print("| wire | mm/s | jitter | lost | NEES | delay rms, stated | sphere over its bound | assembled cloud |")
    print("|---|---|---|---|---|---|---|---|")
    for wire in (False, True):
        for speed in (20.0, 100.0, 200.0):
            for jitter in (0.0, 1e-4, 1e-3):
                for lost in (0.0, 0.02):
                    conditions = {"speed": speed, "rate_hz": speed, "jitter": jitter, "lost": lost}
                    rows = [cell(1000 + seed, wire, **conditions) for seed in range(cells)]
                    nees = np.mean([e @ np.linalg.solve(C, e) for e, C, _ in rows]) / len(NAMED)
                    delay = np.sqrt(np.mean([e[6] ** 2 for e, *_ in rows]))
                    stated = np.sqrt(np.mean([C[6, 6] for _, C, _ in rows]))
                    ball = np.sqrt(np.mean([e[7:] @ e[7:] for e, *_ in rows]) / np.mean([np.trace(C[7:, 7:]) for _, C, _ in rows]))
                    cloud = np.sqrt(np.mean([a @ a for *_, a in rows]))
                    row = f"{'yes' if wire else 'no'} | {speed:.0f} | {1e3 * jitter:g} ms | {lost:.0%} | {nees:.2f}"
                    print(f"| {row} | {1e6 * delay:.1f}, {1e6 * stated:.1f} µs | {ball:.2f} | {1e3 * cloud:.0f} µm |", flush=True)


if __name__ == "__main__":
    main()
