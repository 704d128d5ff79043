"""What a line scanner sees while the arm moves: its laser plane, y = 0 of the scanner, in the world of each moment."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from mbcacq_fakes.world.camera import Camera
from mbcacq_fakes.world.hooks import Moments
from mbcacq_fakes.world.rays import Grid
from mbcacq_fakes.world.rigid import carry, invert
from mbcacq_fakes.world.scanner import FringeScanner, Optics, Scene
from mbcacq_fakes.world.world import SCAN

MARGIN = 4  # cycles around a moment, from which the arm's place is known
POINTS = 640  # of a profile


class ArmHistory(Protocol):
    """The part of ArmState that is read here."""

    axes: int

    def history(self) -> np.ndarray: ...


class LineCamera:
    """A ``LineSource`` in the world of a camera: the same arm, effects, artefacts and operator."""

    def __init__(self, camera: Camera, arm: ArmHistory) -> None:
        self._camera, self._arm, self._count = camera, arm, 0
        view, noise = camera.scanner.grid.view, camera.scanner.noise
        # A laser line's error has no smooth field of a fringe's phase; each point has speckle of its own.
        noise = replace(noise, field_mm=np.zeros(3))
        lamp = np.array([0.0, 0.0, view.near_z + 3 * (view.near_z - view.far_z)])
        self._scanner = FringeScanner(Grid(view, 1, POINTS), noise, Optics(lamp=lamp, edge=0.0))

    def now(self) -> float:
        """Up to where the arm's place between cycles is known."""
        time = self._arm.history()[:, 0]
        return float(time[-MARGIN]) if len(time) > MARGIN else -np.inf

    def profiles(self, times: np.ndarray) -> list[np.ndarray]:
        """(W, 2) mm x and z at each of the times (P,) s of the arm's clock, NaN where nothing was measured."""
        at = self._moments(times)
        world, artefact = self._camera.world, int(at.artefact[0])
        if artefact < 0:
            return [np.full((POINTS, 2), np.nan) for _ in times]
        moved, there = world.displaced(at), world.artefacts[artefact]
        T = invert(world.scanner_pose(at, moved)) @ world.artefact_pose(at, moved)
        shifts = moved.ball[:, world.first_ball[artefact] : world.first_ball[artefact + 1]]
        out = []
        for T_scanner, shift in zip(T, shifts, strict=True):
            self._count += 1
            scene = Scene(carry(T_scanner, there.centres + shift), there.radii, there.carrier, T_scanner)
            points = self._scanner.measure(scene, world.noise(SCAN, self._count))
            frame = self._scanner.frame(points)
            out.append(frame.xyz[0][:, [0, 2]].astype(float))
        return out

    def _moments(self, times: np.ndarray) -> Moments:
        """The arm on a spline through its cycles; everything else as at the cycle before."""
        n, rows = self._arm.axes, self._arm.history()
        rows = rows[np.r_[True, np.diff(rows[:, 0]) > 0]]
        near = slice(
            max(int(np.searchsorted(rows[:, 0], times[0])) - 2 * MARGIN, 0), int(np.searchsorted(rows[:, 0], times[-1])) + 2 * MARGIN
        )
        some = rows[near]
        path = CubicSpline(some[:, 0], some[:, 1 : 1 + n])
        before = some[np.clip(np.searchsorted(some[:, 0], times, side="right") - 1, 0, len(some) - 1)]
        station, artefact = self._camera.standing(path(times[:1])[0])
        count = len(times)
        return self._camera.world.moments(
            path(times),
            path(times, 1),
            before[:, 1 + 2 * n : 1 + 3 * n],
            before[:, -2].astype(int),
            np.maximum(times - self._camera.clock_start_s, 0.0),
            np.full(count, station),
            np.full(count, artefact),
        )
