"""Rigid-body torque against potential energy and power."""

import numpy as np
import pytest
from test_chain import KR10

from mbcacq.geometry.dynamics import nominal_parameters, regressor
from mbcacq.geometry.gravity import gravity_torque

DOWN = np.array([0.0, 0, -1])


def arm(seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(1, 20, 6), rng.normal(0, 100, (6, 3)), rng


def test_at_rest_it_holds_the_weight():
    mass, com, rng = arm()
    q = rng.uniform(-2, 2, (7, 6))
    zero = np.zeros_like(q)
    hold = np.einsum("tjlk,lk->tj", regressor(KR10, q, zero, zero, DOWN), nominal_parameters(mass, com, 3.0, np.array([5.0, 6, 70])))
    pull = gravity_torque(KR10, KR10.frames(q), mass, com, 3.0, np.array([5.0, 6, 70]), DOWN)
    np.testing.assert_allclose(hold, -pull, atol=1e-9)


def test_power_equals_the_change_of_energy():
    """d/dt (kinetic + potential) = torque . speed along any smooth motion; energies from positions alone."""
    mass, com, rng = arm(1)
    amplitude, rate, phase = rng.uniform(0.2, 0.6, 6), rng.uniform(0.5, 2, 6), rng.uniform(0, 6, 6)
    step, at = 1e-4, 0.7

    def motion(time):
        return amplitude * np.sin(rate * time + phase)

    def energy(time):
        def points(at_time):
            frames = KR10.frames(motion(at_time)[None])[0, 1:]
            return (np.einsum("lij,lj->li", frames[:, :3, :3], com) + frames[:, :3, 3]) * 1e-3

        speed = (points(time + step) - points(time - step)) / (2 * step)
        return (0.5 * mass[:, None] * speed**2).sum() + 9.80665 * (mass * points(time)[:, 2]).sum()

    q = motion(at)
    qd = amplitude * rate * np.cos(rate * at + phase)
    qdd = -amplitude * rate**2 * np.sin(rate * at + phase)
    torque = np.einsum("tjlk,lk->tj", regressor(KR10, q[None], qd[None], qdd[None], DOWN), nominal_parameters(mass, com))[0]
    power = (energy(at + 1e-3) - energy(at - 1e-3)) / 2e-3
    assert torque @ qd == pytest.approx(power, rel=1e-4)
