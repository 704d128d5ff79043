"""Short sequences of telegrams at random moments of motions, in simulated time: what is lost, late or counted twice, close together."""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np

from rsi.path import ACCELERATION, ARMS, JERK, NAMES, ROUNDING_DEG, SPEED, Controller, T

FATES = ("good", "lost", "rejected", "counted", "late", "burst", "repeated", "swapped")
LONGEST = 8  # telegrams of a sequence
CALM, SHARES = (4, 60, 200), (0.5, 0.44, 0.06)  # good ones between two, at most; how often which
A_MOTION = 12  # sequences, then the arm turns elsewhere
A_SESSION = 1000  # sequences
RESTARTS = 0.5  # share of the sessions that end with a restart of the controller


def session(seed: int, number: int) -> tuple[float, float, float, Counter]:
    """One session of a controller: largest speed, acceleration and jerk of its set points, in shares of the limits; how often what came."""
    rng = np.random.default_rng([seed, number])
    one = Controller(False, *ARMS[number % len(ARMS)], rng)
    came: Counter = Counter()
    try:
        one.connect()
        for k in range(A_SESSION):
            if k % A_MOTION == 0:
                one.move()
            for _ in range(int(rng.integers(0, rng.choice(CALM, p=SHARES)))):
                one.cycle()
            fates = [FATES[i] for i in rng.integers(0, len(FATES), rng.integers(1, LONGEST + 1))]
            for fate in fates:
                one.cycle("good" if one.behind else fate)
            came["sequences"] += 1
            came["telegrams"] += len(fates)
            if (fault := one.shared.fault()) is not None:
                came[fault["kind"]] += 1
                break
        else:
            one.cycle("restarted" if rng.random() < RESTARTS else "good")
        for _ in range(200):  # nothing moves after a stop
            one.cycle()
    finally:
        one.shared.close()
    path, given = np.array(one.path), np.array(one.given)
    changes = np.abs(np.diff(path, 2, axis=0)).max(axis=1)[given[2:]]
    smooth = given[3:] & given[2:-1] & given[1:-2] & given[:-3]
    jerks = np.abs(np.diff(path, 3, axis=0)).max(axis=1)[smooth]
    speed = (np.abs(np.diff(path, axis=0)).max(initial=0.0) - 2 * ROUNDING_DEG) / (SPEED * T)
    acceleration = (changes.max(initial=0.0) - 4 * ROUNDING_DEG) / (ACCELERATION * T**2)
    jerk = (jerks.max(initial=0.0) - 8 * ROUNDING_DEG) / (JERK * T**3)
    came["cycles"] += len(path)
    return float(speed), float(acceleration), float(jerk), came


def sequences(given: argparse.Namespace) -> int:
    """Sequences of one to eight telegrams, each good, lost, late, rejected, counted though taken, held up, repeated or overtaken, at random
    moments of motions to random places; is every pair of set points that the controller has within speed, acceleration and jerk?
    """
    worst, came, number = np.zeros((len(ARMS), 3)), Counter(), given.first
    while came["sequences"] < given.sequences:
        *shares, counts = session(given.seed, number)
        worst[number % len(ARMS)] = np.maximum(worst[number % len(ARMS)], shares)
        if max(shares) > 1.001:
            print(f"session {number}: speed {shares[0]:.4f}, acceleration {shares[1]:.4f}, jerk {shares[2]:.4f}", flush=True)
        came, number = came + counts, number + 1
    for name, (speed, acceleration, jerk) in zip(NAMES, worst, strict=True):
        print(f"{name}: speed {speed:.4f}, acceleration {acceleration:.4f}, jerk {jerk:.4f}")
    print(f"{number - given.first} sessions: {dict(came)}")
    return int(worst.max() > 1.001)
