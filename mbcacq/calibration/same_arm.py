"""Whether what was learnt on an arm may be applied to a recording or a plan: only if the arm has the same name and nominal links."""

from __future__ import annotations

from mbcacq.errors import ConfigError
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import RobotModel


def refuse_other_arm(learnt: str, name: str, nominal: Chain, robot: RobotModel, other: str) -> None:
    """Raises ConfigError where ``robot`` has another name or other nominal links than the arm learnt on, which is ``nominal`` as described.

    learnt: what was learnt, as in 'the result is of'; other: what it is to be applied to, as in 'the recording'.
    """
    if robot.name == name and robot.chain.same_links(nominal):
        return
    links = ", other nominal links" if robot.name == name and robot.n == nominal.n else ""
    raise ConfigError(
        f"{learnt} '{name}' ({nominal.n} axes), and {other} is of '{robot.name}' ({robot.n} axes{links}); "
        "give what was learnt on the same arm"
    )
