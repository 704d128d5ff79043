"""The loop in C and numpy make the same of any surface, to the last bit; without a compiler numpy does it."""

import numpy as np
import pytest
from mbcacq_gocator import conversion
from mbcacq_gocator.build_loop import SOURCE, build, library_of
from mbcacq_gocator.conversion import load, picked, valid_points

SCALE, OFFSET = np.array([0.002351, -0.003003, 0.001713]), np.array([-71.003, 1.0, 250.001])
SHAPES = [(1, 1), (3, 7), (1, 40_000), (40_000, 1), (257, 311)]


def surface(shape, missing, seed=0):
    """(L, W, 3) int16; x and y can be invalid where z is not."""
    rng = np.random.default_rng(seed)
    raw = rng.integers(-32768, 32768, (*shape, 3)).astype("<i2")
    raw[rng.random(shape) < missing] = -32768
    raw[rng.random((*shape, 3)) < missing / 10] = -32768
    return raw


def unaligned(raw):
    """The same array at an odd address, as a message behind another may stand."""
    data = np.empty(raw.nbytes + 1, np.uint8)
    data[1:] = raw.reshape(-1).view(np.uint8)
    return np.frombuffer(data, raw.dtype, raw.size, 1).reshape(raw.shape)


def by(loop, monkeypatch, raw, every):
    monkeypatch.setattr(conversion, "compiled", lambda: loop)
    points, pixel = valid_points(raw, SCALE, OFFSET, every)
    return points.view(np.uint32), pixel, picked((np.arange(raw.shape[0] * raw.shape[1]) % 251).reshape(raw.shape[:2]), pixel)


@pytest.mark.parametrize("every", [False, True])
@pytest.mark.parametrize("missing", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_both_ways_agree_to_the_last_bit(compiled_loop, monkeypatch, shape, missing, every):
    cloud = surface(shape, missing)
    for raw in (cloud, cloud[..., 2].copy(), unaligned(cloud)):
        for a, b in zip(by(compiled_loop, monkeypatch, raw, every), by(None, monkeypatch, raw, every), strict=True):
            np.testing.assert_array_equal(a, b)


def test_every_coordinate_can_be_asked_for(monkeypatch, compiled_loop):
    raw = np.array([[[1, 2, 3], [-32768, 2, 3], [1, -32768, 3], [1, 2, -32768]]], "<i2")
    for loop in (compiled_loop, None):
        assert by(loop, monkeypatch, raw, False)[1].tolist() == [0, 1, 2]
        assert by(loop, monkeypatch, raw, True)[1].tolist() == [0]


def test_a_library_of_another_source_is_not_loaded(tmp_path, compiled_loop):
    changed = tmp_path / "surface_loop.c"
    changed.write_text(SOURCE.read_text() + "\n")
    assert build(SOURCE, tmp_path) == library_of(SOURCE, tmp_path)
    assert load(library_of(changed, tmp_path)) is None


def test_without_a_compiler_nothing_is_built_and_an_earlier_library_stays(tmp_path, monkeypatch):
    there = library_of(SOURCE, tmp_path)
    there.touch()
    monkeypatch.setenv("CC", "no-such-compiler")
    assert build(SOURCE, tmp_path) is None
    assert there.exists()
    assert load(there) is None  # it is empty


def test_a_source_that_does_not_compile_is_no_error(tmp_path, compiled_loop):
    broken = tmp_path / "surface_loop.c"
    broken.write_text("int main(void { return 0; }")
    assert build(broken, tmp_path) is None


def test_a_pixel_outside_of_the_image_is_refused():
    with pytest.raises(IndexError):
        picked(np.zeros((3, 4), np.uint8), np.array([0, 5, 12], np.int32))
