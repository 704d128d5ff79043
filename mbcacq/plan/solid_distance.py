"""Signed distance between two solids, by MuJoCo's geometry: exact for lines, capsules and boxes, whatever their orientation."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from threading import Lock
from typing import Any

import numpy as np

from mbcacq.plan.collision import Body

TWO_SOLIDS = "<mujoco><worldbody>" + 2 * "<body mocap='true'><geom type='capsule' size='1 1'/></body>" + "</worldbody></mujoco>"
FARTHEST_M = 1e3


class SolidDistance:
    """A model of two solids, which take the shapes and places that are asked for."""

    def __init__(self) -> None:
        self._lock = Lock()

    @cached_property
    def _measured(self) -> Callable[[Body, np.ndarray, Body, np.ndarray], float]:
        mujoco: Any = import_module("mujoco")  # slow to load
        model = mujoco.MjModel.from_xml_string(TWO_SOLIDS)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        box, capsule, distance = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CAPSULE), mujoco.mj_geomDistance
        kinds, sizes, origins, orientations = model.geom_type, model.geom_size, data.geom_xpos, data.geom_xmat.reshape(2, 3, 3)

        def measured(a: Body, T_a: np.ndarray, b: Body, T_b: np.ndarray) -> float:
            for number, body, T in ((0, a, T_a), (1, b, T_b)):
                kinds[number], sizes[number] = capsule if body.rounding > 0 else box, body.extent_m
                origins[number], orientations[number] = T[:3, 3], T[:3, :3]
            origins[:] *= 1e-3
            return 1e3 * distance(model, data, 0, 1, FARTHEST_M, None)

        return measured

    def __call__(self, a: Body, T_a: np.ndarray, b: Body, T_b: np.ndarray) -> float:
        """mm, negative: depth of the overlap; T_a, T_b: (4, 4) places of the bodies."""
        with self._lock:
            return self._measured(a, T_a, b, T_b)
