"""A checker at the controller's side: random motions with lost telegrams, lost and late answers, stops and turns; every set point that the
controller is given is compared with the limits of speed and acceleration on the path that it saw.

python benchmarks/rsi_path.py [MOTIONS] [SEED]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "kuka"))
from rsi_bench import ACCELERATION, LIMITS, SPEED, Bench, T

EVENTS = ("good", "lost", "rejected", "late")
SHARES = (0.94, 0.02, 0.02, 0.02)
ROUNDING_DEG = 1e-6  # of the answers


def one_cycle(bench: Bench, event: str) -> bool:
    """Whether the controller was given a set point that it used."""
    used = len(bench.sent)
    if event == "lost":
        bench.ipoc += 4
        bench.delay += 1
    elif event == "late":
        bench.ipoc += 4
        bench.reply(bench.telegram(), in_time=False)
        bench.delay += 1
    else:
        bench.cycle(accepted=event == "good")
    return len(bench.sent) > used


def drive(rng: np.random.Generator) -> tuple[float, float, float]:
    """One motion: largest speed and acceleration in shares of their limits, and the largest step (deg) after the stop at its end."""
    bench = Bench(late_limit=1_000_000)
    try:
        low, high = np.array(LIMITS).T
        path, given = [bench.sent[-1]] * 3, []
        stop_at, turn_at = rng.integers(20, 160), rng.integers(20, 300)
        bench.move(tuple(rng.uniform(low, high)))
        for cycle in range(300):
            if cycle == turn_at and turn_at < stop_at:
                bench.move(tuple(rng.uniform(low, high)))
            elif cycle == stop_at:
                bench.stop()
            given.append(one_cycle(bench, str(rng.choice(EVENTS, p=SHARES))))
            path.append(bench.sent[-1])
    finally:
        bench.shared.close()
    new, angles = np.array(given), np.array(path)
    speed = np.abs(np.diff(angles, axis=0)).max() - 2 * ROUNDING_DEG
    change = np.abs(np.diff(angles, 2, axis=0)).max(axis=1)[-len(given) :][new].max() - 4 * ROUNDING_DEG
    return speed / (SPEED * T), change / (ACCELERATION * T**2), float(np.abs(np.diff(angles[-20:], axis=0)).max())


def main() -> int:
    motions, seed = (int(v) for v in (*sys.argv[1:], "10000", "1")[:2]) if len(sys.argv) != 2 else (int(sys.argv[1]), 1)
    found = np.array([drive(np.random.default_rng([seed, k])) for k in range(motions)])
    speed, acceleration, after = found.max(axis=0)
    shares = f"speed {speed:.4f}, acceleration {acceleration:.4f} of their limits at most"
    print(f"{motions} motions: {shares}; after the stop {after:.1e} deg a cycle")
    return int(speed > 1.001 or acceleration > 1.001 or after > 0.0)


if __name__ == "__main__":
    sys.exit(main())
