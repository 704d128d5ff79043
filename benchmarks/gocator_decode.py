"""How fast a Gocator's 2-megapixel surface becomes points in mm, against a plain copy of the same bytes.

Usage: python benchmarks/gocator_decode.py [repetitions]. Prints a table and writes benchmarks/gocator_decode.md.
The copy goes into memory that is already mapped, which is the hardest comparison; the decoder makes new arrays.
"""

from __future__ import annotations

import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mbcacq_fakes.protocols.gocator import FakeGocator, encode
from mbcacq_fakes.protocols.gocator.quantise import Scaling, extent, uniform_grid
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator.decode import decode
from mbcacq_gocator.driver import Gocator
from mbcacq_gocator.points import intensity_of, surface_points

SHAPE = (1250, 1650)


def frame(missing: float) -> ScannerFrame:
    """A wavy surface; ``missing`` is the share of pixels lost, in patches as shadows are and in single pixels."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    xyz = np.stack([x * 0.05 - 41, y * 0.05 - 31, 210 + 8 * np.sin(x / 90) * np.cos(y / 70)], axis=2)
    lost = rng.random(SHAPE) < missing / 50
    while lost.mean() < missing:
        row, column = rng.integers(0, SHAPE[0] - 60), rng.integers(0, SHAPE[1] - 80)
        lost[row : row + 60, column : column + 80] = True
    xyz[lost] = np.nan
    return ScannerFrame(xyz, (x + y).astype(np.uint32).astype(np.uint8))


def seconds(action: Callable[[], object], repetitions: int, clock: Callable[[], float] = time.thread_time) -> float:
    """Median time of one call, by default the processor time of this thread."""
    times = []
    for _ in range(repetitions):
        start = clock()
        action()
        times.append(clock() - start)
    return statistics.median(times)


def rows(repetitions: int) -> list[tuple[str, float, float, float, float]]:
    """(what, MB, ms, GB/s, share of the copy's speed) a row."""
    result = []
    for missing in (0.0, 0.3):
        seen = frame(missing)
        scaling = Scaling.over(*extent(seen.xyz))
        cloud = encode.surface_points(seen.xyz, scaling, 0)
        grey = encode.surface_intensity(seen.intensity, scaling, 0)
        height = encode.uniform_surface(*uniform_grid(seen.xyz, None)[::2], 0)

        def with_intensity(cloud: bytes = cloud, grey: bytes = grey) -> None:
            intensity_of(decode(grey)[0], surface_points(decode(cloud)[0]))

        cases = (
            ("surface point cloud", len(cloud), lambda cloud=cloud: surface_points(decode(cloud)[0])),
            ("point cloud and intensity", len(cloud) + len(grey), with_intensity),
            ("uniform surface", len(height), lambda height=height: surface_points(decode(height)[0])),
        )
        for name, size, action in cases:
            source, target = np.zeros(size, np.uint8) + 1, np.zeros(size, np.uint8) + 1
            copy_s = seconds(lambda target=target, source=source: np.copyto(target, source), repetitions)
            decode_s = seconds(action, repetitions)
            result.append((f"{name}, {missing:.0%} invalid", size / 1e6, decode_s * 1e3, size / decode_s / 1e9, copy_s / decode_s))
    return result


def captures(repetitions: int) -> float:
    """Median seconds from snapshot to Scan over the loopback, the fake sensor in the same process."""
    seen = frame(0.3)
    with (
        FakeGocator(lambda exposure_us: seen) as sensor,
        Gocator(
            "front",
            "",
            {
                "address": "127.0.0.1",
                "control_port": sensor.ports.control,
                "health_port": sensor.ports.health,
                "data_port": sensor.ports.data,
            },
        ) as scanner,
    ):
        scanner.capture()
        return seconds(scanner.capture, repetitions, time.perf_counter)


def main() -> None:
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 41
    lines = [
        f"{SHAPE[0]} x {SHAPE[1]} pixels, median of {repetitions}, numpy {np.__version__}, {platform.machine()}.",
        "",
        "| message | MB | ms | GB/s | of a plain copy of the same bytes |",
        "|---|---|---|---|---|",
    ]
    lines += [f"| {name} | {size:.1f} | {ms:.2f} | {speed:.1f} | {ratio:.2f} |" for name, size, ms, speed, ratio in rows(repetitions)]
    whole_ms = captures(max(repetitions // 4, 5)) * 1e3
    lines += ["", f"Snapshot to points over the loopback, sensor and driver in one process: {whole_ms:.0f} ms."]
    text = "\n".join(lines)
    print(text)
    Path(__file__).with_suffix(".md").write_text("# Gocator decode\n\n" + text + "\n")


if __name__ == "__main__":
    main()
