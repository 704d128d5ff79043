"""The long bar: two equal balls, mostly one in view."""

import clouds
import numpy as np
import pytest

from mbcacq.errors import DeviceFault
from mbcacq.spheres.extract import find_spheres

BAR = clouds.make(np.array([[-240, 0, 0], [240, 0, 0.0]]), diameter=25.0, name="bar", first=9)
SHORT = clouds.make(np.array([[-25, 0, 0], [25, 0, 0.0]]), diameter=25.0, name="bar", first=9)
AT = np.array([[4.0, -3.0, 2.0]])


@pytest.fixture(scope="module")
def one():
    return clouds.scan(np.random.default_rng(0), AT, 25.0, spacing=0.4)


@pytest.mark.parametrize("ball", [9, 10])
@pytest.mark.parametrize("off", [None, [[9.0, -12.0, 8.0]]])
def test_one_ball_is_the_expected_one(one, ball, off):
    found = find_spheres(one, BAR, expected=[ball], predicted=None if off is None else AT + off)
    assert found.ball.tolist() == [ball]
    np.testing.assert_allclose(found.xyz, AT, atol=0.002)


def test_one_ball_without_expectation_has_no_name(one):
    found = find_spheres(one, BAR)
    assert len(found) == 0
    assert "its id is undecided" in found.refused[0][0]


def test_of_two_balls_in_view_the_expected_is_the_one_near_its_place():
    two = AT + [[0, 0, 0], [45, 30, 0]]
    points = clouds.scan(np.random.default_rng(0), two, 25.0, spacing=0.4)
    found = find_spheres(points, BAR, expected=[10], predicted=two[1:] + 8.0)
    assert found.ball.tolist() == [10]
    np.testing.assert_allclose(found.xyz[0], two[1], atol=0.002)
    assert "does not belong" in found.refused[0][0]


def test_two_equal_balls_need_a_prediction():
    points = clouds.scan(np.random.default_rng(0), SHORT.centres, 25.0, spacing=0.4)
    assert len(find_spheres(points, SHORT)) == 0
    for turn in (1, -1):
        found = find_spheres(points, SHORT, expected=[9, 10], predicted=turn * SHORT.centres + [9.0, -7.0, 5.0])
        assert found.ball.tolist() == [9, 10]
        np.testing.assert_allclose(found.xyz, turn * SHORT.centres, atol=0.002)


def test_two_balls_at_the_wrong_distance_are_another_bar():
    points = clouds.scan(np.random.default_rng(0), SHORT.centres * 1.04, 25.0, spacing=0.4)
    with pytest.raises(DeviceFault, match="wrong artefact in view"):
        find_spheres(points, SHORT, expected=[9, 10], predicted=SHORT.centres)


def test_the_small_balls_of_another_artefact_are_refused():
    other = clouds.artefact()
    with pytest.raises(DeviceFault, match=r"wrong artefact in view: .* 1[12]\.\d+ mm"):
        find_spheres(clouds.scan(np.random.default_rng(0), other.centres, 12.0, spacing=0.3), BAR, expected=[9])
