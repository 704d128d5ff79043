"""Bracketed exposures: a bright and a dark half, each measurable with one exposure only, end in one whole scan."""

from __future__ import annotations

import numpy as np
import pytest
from gocator_bench import options
from mbcacq_fakes.protocols.gocator import FakeGocator
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator.bracket import best, merged
from mbcacq_gocator.driver import Gocator

from mbcacq.devices import ConfigError, ProtocolError, Scan

REFLECTIVITY = np.where(np.arange(20) < 12, 0.02, 0.25)  # grey values a microsecond: dark left, bright right


def frame_for(exposure_us: float) -> ScannerFrame:
    """What reflects too little or too much light gives no point; each exposure is shifted in z by itself, to tell them apart."""
    y, x = np.mgrid[:12, :20].astype(np.float32)
    grey = np.clip(REFLECTIVITY * exposure_us, 0, 255) * np.ones((12, 1))
    xyz = np.stack([x, y, np.full_like(x, 200 + exposure_us / 1000)], axis=2)
    xyz[(grey < 5) | (grey >= 255)] = np.nan
    return ScannerFrame(xyz, grey.astype(np.uint8))


@pytest.fixture
def sensor():
    with FakeGocator(frame_for) as made:
        yield made


def test_merging_takes_every_pixel_from_the_exposure_that_sees_it_best(sensor):
    with Gocator("front", "", options(sensor, exposures_us=[500, 2000, 6000])) as scanner:
        scan = scanner.capture()
    assert len(scan.points) == 12 * 20
    assert (scan.pixel == np.arange(240)).all()
    grid = scan.points.reshape(12, 20, 3)
    np.testing.assert_allclose(grid[:, :12, 2], 206.0, atol=2e-3)  # 120 of 255 at 6 ms; 40 at 2 ms
    np.testing.assert_allclose(grid[:, 12:, 2], 200.5, atol=2e-3)  # 125 at 0.5 ms
    assert set(scan.intensity.tolist()) == {120, 125}
    assert scan.exposure_us == 6000


def test_best_takes_one_exposure_whole(sensor):
    with Gocator("front", "", options(sensor, exposures_us=[500, 2000, 6000], bracket="best")) as scanner:
        scan = scanner.capture()
    assert (scan.exposure_us, len(scan.points)) == (500, 240)  # its dark half has grey 10, just usable; the others see 12 columns


def test_the_exposure_of_before_is_put_back(sensor):
    before = sensor.files.read("_live.cfg")
    with Gocator("front", "", options(sensor, exposures_us=[500, 6000], mode="trigger")) as scanner:
        scanner.capture()
        scanner.capture()
    assert sensor.files.read("_live.cfg") == before


def test_a_bracket_that_the_sensor_cannot_do_is_refused_on_connecting(sensor):
    with pytest.raises(ConfigError, match="an exposure of 5e\\+06 us is outside"):
        Gocator("front", "", options(sensor, exposures_us=[500, 5e6])).connect()
    assert sensor.state.exposures == 0


@pytest.mark.parametrize(
    "given",
    [
        {"exposures_us": [500, 500]},
        {"exposures_us": [0]},
        {"exposures_us": 500},
        {"exposures_us": ["500"]},
        {"exposures_us": [500], "exposure_us": 1},
        {"exposures_us": [500], "bracket": "mean"},
    ],
)
def test_wrong_brackets_are_named(given):
    with pytest.raises(ConfigError, match="exposure|bracket"):
        Gocator("front", "", {"address": "1.2.3.4", **given})


def test_plan_and_option_cannot_both_say_how_long(sensor):
    with (
        Gocator("front", "", options(sensor, exposures_us=[500])) as scanner,
        pytest.raises(ConfigError, match="take exposure_us out of the plan"),
    ):
        scanner.capture(700)


def scan_of(pixel: list[int], grey: list[int] | None, z: float, shape: tuple[int, int] = (1, 4)) -> Scan:
    points = np.array([[p, 0, z] for p in pixel], np.float32)
    return Scan(points, None if grey is None else np.array(grey, np.uint8), shape, np.array(pixel, np.int32), exposure_us=z)


def test_without_grey_values_the_fuller_exposure_leads():
    one, two = scan_of([0, 1], None, 1.0), scan_of([1, 2, 3], None, 2.0)
    result = merged([one, two])
    assert result.pixel.tolist() == [0, 1, 2, 3]
    assert result.points[:, 2].tolist() == [1, 2, 2, 2]
    assert result.intensity is None
    assert best([one, two]) is two


def test_merging_is_the_same_in_any_order_and_keeps_a_single_scan():
    rng = np.random.default_rng(5)
    scans = []
    for k in range(4):
        pixel = np.flatnonzero(rng.random(60) < 0.6)
        scans.append(scan_of(pixel.tolist(), rng.integers(0, 118, len(pixel)).tolist(), float(k), (6, 10)))
    forward, backward = merged(scans), merged(scans[::-1])
    assert forward.pixel.tolist() == backward.pixel.tolist() == sorted(set(np.concatenate([s.pixel for s in scans])))
    assert forward.intensity.tolist() == backward.intensity.tolist()
    alone = merged(scans[:1])
    assert alone.points.tolist() == scans[0].points.tolist()


def test_different_grids_cannot_be_merged():
    with pytest.raises(ProtocolError, match="different sizes"):
        merged([scan_of([0], [9], 1.0), scan_of([0], [9], 1.0, (2, 4))])
