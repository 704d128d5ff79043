"""Images of a board in words: the camera's intrinsics, and what each image shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mbcacq.quantities import K, pair


def camera_rows(images: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(name, value with its expanded uncertainty) of the intrinsics."""
    out = []
    for name, one in images["intrinsics"].items():
        value, U = pair(float(one["value"]), K * float(one["std"]) or None)
        out.append((str(name), f"{value} ± {U}" if one["std"] else f"{float(one['value']):.6g}"))
    return out


def image_rows(images: Mapping[str, Any]) -> list[tuple[str, str, str, str, str]]:
    """(name, points, rms px, largest px, why it is not used or '') of each image."""

    def figure(value: float | None) -> str:
        return "–" if value is None else f"{float(value):.3f}"

    every = images["images"]
    return [(str(o["name"]), str(o["points"]), figure(o["rms_px"]), figure(o["worst_px"]), str(o["reason"])) for o in every]
