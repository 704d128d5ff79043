"""The independent cell as the tool gets it: observations, and the context in which the catalogue makes its candidates."""

from dataclasses import replace

import independent_cell as plain
import numpy as np
from independent_cell import World

from mbcacq.effects.context import Context
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations

FIRST_POSE = 100  # numbers of poses are not their indices


def context(world: World, recorded_temperature: bool = True) -> Context:
    """The recording of the perfect cell, with the true geometry."""
    chain = Chain(plain.SIGN, plain.THETA, plain.D, plain.A, plain.ALPHA, np.zeros(6))
    robot = RobotModel(
        "independent arm",
        chain,
        np.radians([[-350.0, 350.0], [-140.0, 60.0], *[[-350.0, 350.0]] * 4]),
        plain.MASS,
        plain.COM,
        gear_ratio=np.array([119.2, 126.1, 99.6, 80, 80.9, 50.4]),
        payload_mass=plain.PAYLOAD,
        payload_com=plain.PAYLOAD_COM,
        gravity=plain.DOWN,
    )
    artefact = Artefact("mbc", "eight balls", tuple(range(1, 9)), plain.BALLS, np.full(8, 12.0))
    cell = Cell(robot, plain.T_FLANGE_SCANNER, (artefact,), (Station("1", "mbc"), Station("2", "mbc")), "scanner", np.full(3, 0.005))
    count = len(world.q)
    obs = Observations(
        cell,
        FIRST_POSE + np.arange(count),
        world.station,
        world.q,
        world.pose_of_centre,
        np.tile(np.arange(8), count),
        world.measure(),
        time_s=world.time,
        direction=world.direction,
        velocity=world.velocity,
        temperatures={"robot_C": world.temperature},
    )
    if not recorded_temperature:
        obs = replace(obs, temperatures={})
    state = CellState(chain, plain.T_FLANGE_SCANNER, world.stations, plain.BALLS)
    return Context(obs, state, forward_model.predict(obs, state))
