"""Signed distance between two solids, by MuJoCo's geometry: exact for lines, capsules and boxes, whatever their orientation."""

from __future__ import annotations

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
    def _scene(self) -> tuple[Any, Any, Any]:
        mujoco: Any = import_module("mujoco")  # slow to load
        model = mujoco.MjModel.from_xml_string(TWO_SOLIDS)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        return mujoco, model, data

    def __call__(self, a: Body, T_a: np.ndarray, b: Body, T_b: np.ndarray) -> float:
        """mm, negative: depth of the overlap; T_a, T_b: (4, 4) places of the bodies."""
        with self._lock:
            mujoco, model, data = self._scene
            for number, (body, T) in enumerate(((a, T_a), (b, T_b))):
                if body.rounding > 0:
                    kind, size = mujoco.mjtGeom.mjGEOM_CAPSULE, (body.rounding, body.length / 2, 0.0)
                else:
                    kind, size = mujoco.mjtGeom.mjGEOM_BOX, body.sides / 2
                model.geom_type[number], model.geom_size[number] = kind, np.divide(size, 1e3)
                data.geom_xpos[number], data.geom_xmat[number] = T[:3, 3] / 1e3, T[:3, :3].reshape(-1)
            return 1e3 * mujoco.mj_geomDistance(model, data, 0, 1, FARTHEST_M, None)
