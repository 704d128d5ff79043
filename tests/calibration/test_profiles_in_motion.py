"""Line profiles taken in motion: one adjustment of hand-eye transform, sphere and clock, at its bound."""

from dataclasses import replace

import numpy as np
import pytest
from sweep_data import RADIUS, coordinates, sweeps

from mbcacq.calibration.profile_clock import SeenSections, adjust_in_motion, start_in_motion
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.flange_poses import flange_transforms
from mbcacq.geometry.motion_in_time import FlangeMotion
from mbcacq.spheres.circles import circles_in


def seen_and_motion(made):
    circles, noise = circles_in(made.points, RADIUS)
    keep = np.array([c is not None for c in circles])
    count = int(keep.sum())
    seen = SeenSections(made.profile_s[keep], np.zeros(count, int), np.full(count, RADIUS), [c for c in circles if c], noise)
    return seen, FlangeMotion.of_poses(made.cycle_s, coordinates(made))


def error_of(found, made, drift=0.0):
    """Errors of translation, rotation, delay and sphere, in the order of the covariance without the drift."""
    turn = se3.rotation_log(made.T_hand_eye[:3, :3].T @ found.T_hand_eye[:3, :3])
    delay = made.delay_s + drift * (found.clock.epoch_s + made.delay_s - made.epoch_s)
    off = found.T_hand_eye[:3, 3] - made.T_hand_eye[:3, 3]
    return np.r_[off, turn, found.clock.delay_s - delay, found.spheres[0] - made.sphere]


STATED = [0, 1, 2, 3, 4, 5, 6, 8, 9, 10]


@pytest.mark.parametrize(("jitter", "lost"), [(0.0, 0.0), (1e-3, 0.02)])
def test_sweeps_forth_and_back_determine_clock_and_hand_eye_as_stated(jitter, lost):
    """Without a wire, at 100 mm/s: the chi square of 40 degrees of freedom is below 1.84 times these, and above 0.45, at 1e-3."""
    nees, delays = [], []
    for seed in range(4):
        made = sweeps(np.random.default_rng(seed), jitter=jitter, lost=lost, drift=3e-5)
        seen, motion = seen_and_motion(made)
        found = adjust_in_motion(motion, seen, start_in_motion(motion, seen))
        off, C = error_of(found, made, 3e-5), found.covariance[np.ix_(STATED, STATED)]
        nees.append(off @ np.linalg.solve(C, off) / 10)
        delays.append(off[6])
        assert found.clock.jitter_s == pytest.approx(jitter, rel=0.2, abs=6e-5)
    assert 0.45 < np.mean(nees) < 1.84
    assert np.abs(delays).max() < (50e-6 if jitter == 0 else 250e-6)


def test_clocks_that_began_at_other_times_are_brought_together():
    made = sweeps(np.random.default_rng(1), delay=0.31, speed=60.0)
    seen, motion = seen_and_motion(made)
    found = adjust_in_motion(motion, seen, start_in_motion(motion, seen))
    assert found.clock.delay_s == pytest.approx(0.31, abs=50e-6)


def test_the_delay_of_a_wire_outweighs_what_single_sweeps_say():
    made = sweeps(np.random.default_rng(2), lines=8, jitter=5e-4)
    seen, motion = seen_and_motion(made)
    start = start_in_motion(motion, seen)
    alone, wired = adjust_in_motion(motion, seen, start), adjust_in_motion(motion, seen, start, (made.delay_s, 1e-6))
    assert wired.clock.covariance[0, 0] < 0.1 * alone.clock.covariance[0, 0]
    assert abs(wired.clock.delay_s - made.delay_s) < 5e-6


def test_a_profile_without_cycles_around_it_has_no_pose_and_gross_errors_are_left_out():
    made = sweeps(np.random.default_rng(4), lines=6)
    seen, motion = seen_and_motion(made)
    middle = seen.time_s[200] + made.delay_s
    there = np.abs(motion.time_s - middle) > 0.02
    gapped = replace(motion, time_s=motion.time_s[there], q=motion.q[there])
    circles = list(seen.circles)
    circles[50] = replace(circles[50], centre=circles[50].centre + [0.5, -0.4])
    wrong = replace(seen, circles=circles)
    found = adjust_in_motion(gapped, wrong, start_in_motion(gapped, wrong))
    t = found.clock.controller_time(seen.time_s)
    assert not found.used[np.abs(t - middle) < 0.018].any()
    assert not found.used[50]
    assert (~found.used).sum() < 10
    assert found.clock.delay_s == pytest.approx(made.delay_s, abs=30e-6)


def test_poses_between_cycles_follow_a_screw_motion_through_half_a_turn():
    t = np.arange(0, 1, 0.004)
    twist = np.array([90.0, -20, 40, 0.5, 0.3, -0.2])
    begin = se3.transform(se3.rotation_exp(np.array([np.pi - 0.1, 0.0, 0.02])), np.array([600.0, 0, 300]))

    def at(times):
        return begin @ se3.exp(twist * np.asarray(times)[:, None])

    from mbcacq.geometry.flange_poses import flange_coordinates

    motion = FlangeMotion.of_poses(t, flange_coordinates(at(t)))
    between = np.linspace(0.03, 0.97, 200)
    T, velocity = motion.at(between)
    np.testing.assert_allclose(T, at(between), atol=1e-5)
    np.testing.assert_allclose(velocity, np.tile(twist, (200, 1)), atol=5e-3)
    assert not motion.known(np.array([-0.001, 0.9961])).any()
    np.testing.assert_allclose(flange_transforms(motion.coordinates(between)), T)


def test_sweeps_of_one_orientation_are_refused():
    made = sweeps(np.random.default_rng(5), lines=1)
    seen, motion = seen_and_motion(made)
    with pytest.raises(ConfigError, match=r"sweep over the sphere|sweep over it"):
        adjust_in_motion(motion, seen, start_in_motion(motion, seen))
