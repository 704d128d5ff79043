"""A run has both: poses at standstill and the motion between them. What was found in both must agree."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.diagnosis.motion.text import trajectory_words
from mbcacq.diagnosis.output.text import number

AGREE = 3.0  # sigmas


def joined(poses: dict[str, Any], motion: dict[str, Any]) -> dict[str, Any]:
    """The diagnosis of the poses with that of the motion beside it (``motion``), and what both measured (``agreement``)."""
    return poses | {"motion": motion, "agreement": agreement(poses, motion)}


def agreement(poses: dict[str, Any], motion: dict[str, Any]) -> list[dict[str, Any]]:
    """Every parameter that both told: its two values with their standard deviations, how many sigmas they are apart, whether they agree."""
    told = {(e["name"], key): p for e in motion["effects"] for key, p in e["parameters"].items()}
    out = []
    for effect in poses["effects"]:
        for key, mine in effect["parameters"].items():
            other = told.get((effect["name"], key))
            values = None if other is None else [mine.get("value"), mine.get("std"), other.get("value"), other.get("std")]
            if values is None or any(v is None or np.ndim(v) for v in values):
                continue
            apart = abs(values[0] - values[2]) / max(float(np.hypot(values[1], values[3])), 1e-300)
            out.append(
                {
                    "name": effect["name"],
                    "parameter": key,
                    "poses": {"value": values[0], "std": values[1]},
                    "motion": {"value": values[2], "std": values[3]},
                    "sigmas": float(apart),
                    "agrees": bool(apart <= AGREE),
                }
            )
    return out


def words(content: dict[str, Any], poses: str) -> str:
    """poses: the text of the pose diagnosis."""
    lines = [
        "Poses, at standstill",
        "====================",
        poses,
        "",
        "Motion, between the poses",
        "=========================",
        trajectory_words(content["motion"]),
    ]
    if content["agreement"]:
        lines += ["", "Found in both:"]
        lines += [
            f"  {a['parameter']}: {number(a['poses']['value'])} +- {number(a['poses']['std'])} from the poses, "
            f"{number(a['motion']['value'])} +- {number(a['motion']['std'])} from the motion: "
            f"{'they agree' if a['agrees'] else 'they do not agree'} ({a['sigmas']:.1f} sigma)"
            for a in content["agreement"]
        ]
    return "\n".join(lines)
