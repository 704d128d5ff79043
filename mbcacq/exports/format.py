"""A format of a result: a class with a name, found by its entry point in the group ``mbcacq.exports``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mbcacq.calibration.result_io import effects_of, of_flange_poses, state_from_dict
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError
from mbcacq.exports.marks import comments
from mbcacq.exports.mount import UndeterminedMount, is_target, undetermined
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.model.observations import Observations

GROUP = "mbcacq.exports"
TARGET_FRAME = "target_frame"


@dataclass(frozen=True, kw_only=True)
class Targets:
    """Options beyond CSV and JSON.

    Attributes
    ----------
    only
        Names of the formats to write; empty for all.
    tool, tool_name
        Number of the tool on the KUKA controller, and its name there.
    config_dat
        The controller's ``$config.dat``, for a diff against it.
    urdf, joints
        File to patch, with the names of its moving joints, or () for all.
    flange_frame, scanner_frame, base_frame, name
        Names in ROS.
    """

    only: Sequence[str] = ()
    tool: int = 1
    tool_name: str = "mbcacq scanner"
    config_dat: Path | None = None
    urdf: Path | None = None
    joints: Sequence[str] = ()
    flange_frame: str = "tool0"
    scanner_frame: str = "scanner_frame"
    base_frame: str = "base_link"
    name: str = "mbcacq"


@dataclass(frozen=True)
class ExportedResult:
    """What a format writes.

    Attributes
    ----------
    result
        The content of ``result.json``.
    targets
        What is wanted.
    observations
        The calibrated cell, None for a result alone.
    """

    result: Mapping[str, Any]
    targets: Targets
    observations: Observations | None = None

    @cached_property
    def chains(self) -> tuple[Chain, Chain]:
        """Nominal and calibrated arm."""
        return chains(self.result)

    @cached_property
    def T_flange_scanner(self) -> np.ndarray:
        """(4, 4) mm: the calibrated hand-eye transform. Raises UndeterminedMount where the measurements did not determine all of it."""
        if why := undetermined(self.result):
            raise UndeterminedMount(f"{why}, so it cannot be exported; the table of parameters (--only csv) holds what is known")
        return state_from_dict(dict(self.result)).T_flange_scanner

    @property
    def known_mount(self) -> np.ndarray | None:
        """(4, 4) mm as ``T_flange_scanner``; None where the measurements did not determine all of it."""
        return None if undetermined(self.result) else self.T_flange_scanner

    @property
    def of_target(self) -> bool:
        """Whether the frame on the flange is that of a target, and the instrument stands in the base."""
        return is_target(self.result)

    @property
    def instruments(self) -> dict[str, np.ndarray]:
        """T_base_instrument (4, 4) mm by name, of the instruments that stand in the base; empty where the scanner is on the flange."""
        return {s["id"]: np.array(s["T_base_station"], dtype=float) for s in self.result["stations"]} if self.of_target else {}

    @property
    def mounted_frame(self) -> str:
        """Name of the frame on the flange."""
        return TARGET_FRAME if self.of_target else self.targets.scanner_frame

    @cached_property
    def effects(self) -> EffectModel | None:
        """The effects of the arm, None where the result has none."""
        return effects_of(self.result)

    @cached_property
    def comments(self) -> list[str]:
        """Lines that every file should carry: whether the result is simulated, whether it was verified, what the format leaves out."""
        return comments(self.result)

    @property
    def has_joints(self) -> bool:
        """Whether the cell has joints; of one that is known by the poses of its flange alone no kinematics can be written."""
        return not of_flange_poses(self.result)

    @property
    def robot_name(self) -> str:
        return str(self.result["robot"].get("name", ""))


class ExportFormat(ABC):
    """A format of a result. A subclass needs a ``name``, a ``summary`` of one line, and ``files``."""

    name: ClassVar[str]
    summary: ClassVar[str]
    of_joints: ClassVar[bool] = False  # writes the arm's joints

    @abstractmethod
    def files(self, exported: ExportedResult) -> Mapping[str, str | bytes]:
        """The files of this format.

        Parameters
        ----------
        exported
            The result and what is wanted.

        Returns
        -------
        File name -> content. Text gets the result's comments in front if its ending has a form of comment; bytes are written as they are.
        Empty if what is wanted does not ask for this format.

        Raises
        ------
        ConfigError
            If what is wanted does not fit the result.
        """


def chains(result: Mapping[str, Any]) -> tuple[Chain, Chain]:
    """Nominal and calibrated arm of a result."""
    robot = result["robot"]
    kinds = {
        "sliding": tuple(robot.get("sliding", ())),
        "floor": robot.get("floor", 0),
        "root": robot.get("root") and np.array(robot["root"]),
    }
    kinds["follows"] = tuple(map(tuple, robot.get("follows", ())))
    sign, rows = (
        np.array(robot["sign"], dtype=float),
        {w: [np.array(robot[w][p], float) for p in PARAMETERS] for w in ("nominal", "calibrated")},
    )
    return Chain(sign, *rows["nominal"], **kinds), Chain(sign, *rows["calibrated"], **kinds)


def formats(only: Sequence[str] = ()) -> list[ExportFormat]:
    """The formats of the installed packages, or those that are named.

    Raises ConfigError if a name is that of no format or of two, or a format cannot be imported.
    """
    found: dict[str, ExportFormat] = {}
    known = {point.name: point.value for point in entry_points(group=GROUP)}
    if unknown := [name for name in only if name not in known]:
        raise ConfigError(f"there is no format '{unknown[0]}' to export (installed: {', '.join(sorted(known))}); correct --only")
    for point in entry_points(group=GROUP):
        if only and point.name not in only:
            continue
        if point.name in found:
            raise ConfigError(f"the format '{point.name}' is installed twice ({known[point.name]}, {point.value}); uninstall one of them")
        try:
            loaded = point.load()
        except ImportError as error:
            sentence = f"the format '{point.name}' ({point.value}) cannot be imported: {error}; mend or uninstall its package"
            raise ConfigError(sentence) from error
        if not (isinstance(loaded, type) and issubclass(loaded, ExportFormat)):
            raise ConfigError(f"the format '{point.name}': {point.value} is no class derived from ExportFormat; mend its package")
        found[point.name] = loaded()
    return list(found.values())
