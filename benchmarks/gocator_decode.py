"""How fast a Gocator's 2-megapixel surface becomes points in mm, against a plain copy of the same bytes.

Usage: python benchmarks/gocator_decode.py [repetitions] [--before FILE]. Prints a table and writes benchmarks/gocator_decode.md.
FILE is another version of mbcacq_gocator/points.py to compare with. The repetitions of the copy and of the versions take turns, so that
whatever else the computer does concerns all of them. The copy goes into memory that is already mapped, which is the hardest comparison;
the decoder makes new arrays.
"""

from __future__ import annotations

import argparse
import importlib.util
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
from mbcacq_fakes.protocols.gocator import FakeGocator, encode
from mbcacq_fakes.protocols.gocator.quantise import Scaling, extent, uniform_grid
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator import points
from mbcacq_gocator.decode import decode
from mbcacq_gocator.driver import Gocator

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


def medians(actions: Sequence[Callable[[], object]], repetitions: int) -> list[float]:
    """Median processor time of this thread in s for one call of each action; they take turns."""
    times: list[list[float]] = [[] for _ in actions]
    for _ in range(repetitions):
        for own, action in zip(times, actions, strict=True):
            start = time.thread_time()
            action()
            own.append(time.thread_time() - start)
    return [statistics.median(own) for own in times]


def cases(points: ModuleType) -> dict[str, tuple[int, Callable[[], object]]]:
    """By name: bytes of the messages, and what decodes them by ``points``."""
    found = {}
    for missing in (0.0, 0.3):
        seen = frame(missing)
        scaling = Scaling.over(*extent(seen.xyz))
        cloud = encode.surface_points(seen.xyz, scaling, 0)
        raw, raised_grey, grid = uniform_grid(seen.xyz, seen.intensity)
        height = encode.uniform_surface(raw, grid, 0)
        assert seen.intensity is not None
        assert raised_grey is not None
        greys = encode.surface_intensity(seen.intensity, scaling, 0), encode.surface_intensity(raised_grey, grid, 0)

        def surface(message: bytearray) -> object:
            return points.surface_points(decode(message)[0])

        def with_intensity(message: bytearray, grey: bytearray) -> object:
            return points.intensity_of(decode(grey)[0], points.surface_points(decode(message)[0]))

        share = f"{missing:.0%} invalid"
        for name, message, grey in (("surface point cloud", cloud, greys[0]), ("uniform surface", height, greys[1])):
            found[f"{name}, {share}"] = len(message), partial(surface, message)
            found[f"{name} and intensity, {share}"] = len(message) + len(grey), partial(with_intensity, message, grey)
    return found


def rows(repetitions: int, before: ModuleType | None) -> list[tuple[str, float, list[float]]]:
    """(what, MB, medians in ms of copy, decoder and earlier decoder) a row."""
    versions = [cases(each) for each in (points, before) if each is not None]
    result = []
    for name, (size, _) in versions[0].items():
        source, target = np.zeros(size, np.uint8) + 1, np.zeros(size, np.uint8) + 1
        actions = [partial(np.copyto, target, source), *(version[name][1] for version in versions)]
        result.append((name, size / 1e6, [1e3 * t for t in medians(actions, repetitions)]))
    return result


def loaded(path: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location("points_before", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


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
        times = []
        for _ in range(repetitions):
            start = time.perf_counter()
            scanner.capture()
            times.append(time.perf_counter() - start)
    return statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("repetitions", type=int, nargs="?", default=41)
    parser.add_argument("--before", metavar="FILE", help="another version of points.py")
    given = parser.parse_args()
    before = loaded(given.before) if given.before else None
    extra = " before | before / copy | before / now |" if before else ""
    lines = [
        f"{SHAPE[0]} x {SHAPE[1]} pixels, median processor time in ms of {given.repetitions} turns, "
        f"numpy {np.__version__}, {platform.machine()}.",
        "",
        f"| message | MB | copy | now | now / copy |{extra}",
        "|---|---|---|---|---|" + ("---|---|---|" if before else ""),
    ]
    for name, size, (copy, now, *rest) in rows(given.repetitions, before):
        columns = [f"{copy:.2f}", f"{now:.2f}", f"{now / copy:.1f}"]
        columns += [column for old in rest for column in (f"{old:.2f}", f"{old / copy:.1f}", f"{old / now:.2f}")]
        lines.append(f"| {name} | {size:.1f} | {' | '.join(columns)} |")
    whole_ms = captures(max(given.repetitions // 4, 5)) * 1e3
    lines += ["", f"Snapshot to points over the loopback, sensor and driver in one process: {whole_ms:.0f} ms."]
    if before:
        lines += ["", "'before': the same messages by the version of points.py that `--before` named, in turn with the others."]
    text = "\n".join(lines)
    print(text)
    Path(__file__).with_suffix(".md").write_text("# Gocator decode\n\n" + text + "\n")


if __name__ == "__main__":
    main()
