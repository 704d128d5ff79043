"""Periodic error of a gear in its own angle, of an order that is found: gear, encoder or motor periods."""

from __future__ import annotations

import numpy as np

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, orders, sine_report

NAME = "gear_transmission_error"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "q_joint":
        return []
    ratio = runs[0].gear_ratio
    highest = 2.2 * ratio[channel.joint] if ratio is not None else 300.0
    tried = orders(runs, channel.joint, highest)
    if not len(tried):
        return []
    report = sine_report("amplitude_deg", float(np.degrees(1)))
    return [Candidate(
        NAME, (channel.axis,), f"q{channel.joint + 1}", _waves,
        lambda c, v, order: {f"{channel.axis}.{k}": p for k, p in report(c, v, order).items()},
        hyper=tried, several=True, search=len(tried) / 4,
    )]


def _waves(run: Run, joint: int, order: float | None) -> np.ndarray:
    angle = order * run.q[:, joint]
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)
