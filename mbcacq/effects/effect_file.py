"""What a file with effects must hold: keys, kinds, shapes, and every index within the arm that the effects were learnt on.

It is checked once, where it is read: an index beyond the arm would end a calibration, and a negative one would displace another joint.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, FiniteFloat

from mbcacq.effects.effect_term import EffectTerm, LearntRecording
from mbcacq.effects.functions import COMPONENTS, FUNCTIONS, DescribedPart, Function
from mbcacq.errors import ConfigError
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.model.cell import Measurement, RobotModel, counted_axes, tags_of
from mbcacq.model.json_text import EveryKey, Limits, Number, RowsOfTransform, as_rows, damaged, from_document

FORMAT = "mbcacq-effect-model/1"
CURE = "make the model of effects anew with mbcacq diagnose"

_LOCATION = re.compile(r"^(?:A|link|(?=E))(E?[0-9]+)$")
_OF_JOINT = re.compile(
    r"^(?:q|s|qd|tau|direction_|movement_|travel_|travel_direction_|gravity_torque_|payload_torque_)(E?[0-9]+)(?:_(?:mass|x|y|z))?$"
)
_OF_FRAME = re.compile(r"^gravity_(?:moment|direction|along)_(E?[0-9]+)_(?:[xyz]|[0-9]+_[0-9]+)$")
Three = tuple[Number, Number, Number]


@dataclass(frozen=True, kw_only=True)
class ArmInFile(EveryKey):
    """The arm as it is nominally: MD-H rows by parameter (theta, alpha, beta rad; d, a mm), masses and what else covariates need. sliding,
    floor, root: as of ``Chain``; axes: their names."""

    left_out = ("sliding", "floor", "root", "follows", "axes")

    name: str
    sign: Annotated[tuple[Literal[-1, 1], ...], Field(min_length=1)]
    nominal: Annotated[Mapping[Literal["theta", "d", "a", "alpha", "beta"], tuple[FiniteFloat, ...]], Field(min_length=5)]
    limits: Limits
    mass_kg: tuple[Number, ...]
    com_mm: tuple[Three, ...]
    payload_mass_kg: Number
    payload_com_mm: Three
    gravity: Three
    sliding: tuple[int, ...] = ()
    floor: int = 0
    root: RowsOfTransform | None = None
    follows: tuple[tuple[int, int, float], ...] = ()
    axes: tuple[str, ...] = ()

    @classmethod
    def of(cls, robot: RobotModel) -> ArmInFile:
        """The arm as a file holds it."""
        return cls(
            name=robot.name,
            sign=robot.chain.sign.tolist(),
            nominal={p: getattr(robot.chain, p).tolist() for p in PARAMETERS},
            limits=robot.limits,
            mass_kg=robot.mass.tolist(),
            com_mm=robot.com.tolist(),
            payload_mass_kg=float(robot.payload_mass),
            payload_com_mm=np.asarray(robot.payload_com).tolist(),
            gravity=np.asarray(robot.gravity).tolist(),
            sliding=robot.chain.sliding,
            floor=robot.chain.floor,
            root=as_rows(robot.chain.root),
            follows=robot.chain.follows,
            axes=robot.names,
        )

    @property
    def robot(self) -> RobotModel:
        """The arm of a file."""
        rows = (np.array(self.nominal[p]) for p in PARAMETERS)
        root = None if self.root is None else np.array(self.root)
        chain = Chain(np.array(self.sign, dtype=float), *rows, sliding=self.sliding, floor=self.floor, root=root, follows=self.follows)
        arm = RobotModel(self.name, chain, self.limits, np.array(self.mass_kg), np.array(self.com_mm), names=self.axes)
        payload_com, gravity = np.array(self.payload_com_mm), np.array(self.gravity)
        return replace(arm, payload_mass=self.payload_mass_kg, payload_com=payload_com, gravity=gravity)


@dataclass(frozen=True, kw_only=True)
class EffectModelFile:
    """A model of effects as a file holds it: what was measured, the arm, how the recording learnt from is known again, the terms."""

    format: Literal["mbcacq-effect-model/1"]
    measurement: Measurement
    robot: ArmInFile
    learnt: LearntRecording
    terms: tuple[EffectTerm, ...]


def read_effects(content: Any, source: str, key: str = "") -> EffectModelFile:
    """The content of a model of effects, where it is whole. source: how a message calls the file; key: under which the model is in it.

    Raises ConfigError with the key of the fault.
    """
    return from_document(EffectModelFile, content, FORMAT, source, "model of effects", CURE, key)


def check_effects(model: EffectModelFile, source: str, key: str = "") -> None:
    """Refuse indices beyond the arm, lengths that differ, and functions without a value. Raises ConfigError as ``read_effects``."""
    within = f"{key}." if key else ""
    robot, axes = model.robot, len(model.robot.sign)
    of_axes = {"limits": robot.limits, "mass_kg": robot.mass_kg, "com_mm": robot.com_mm}
    for name, values in {**of_axes, **{f"nominal.{p}": column for p, column in robot.nominal.items()}}.items():
        if len(values) != axes:
            raise _damaged(source, f"{within}robot.{name}", f"{len(values)} values for {axes} axes")
    tags = tags_of(robot.axes or counted_axes(axes))
    for i, term in enumerate(model.terms):
        _check_term(term, tags, source, f"{within}terms.{i}")


def _check_term(term: EffectTerm, tags: tuple[str, ...], source: str, key: str) -> None:
    k = len(term.names)
    for name in ("units", "coefficients", "std", "sigma", "typical"):
        if len(getattr(term, name)) != k:
            raise _damaged(source, f"{key}.{name}", f"{len(getattr(term, name))} values for {k} coefficients")
    for j, s in enumerate(term.sigma):
        if s <= 0:
            raise _damaged(source, f"{key}.sigma.{j}", f"{s:g} is no standard deviation: it must be larger than zero, or null for none")
    for j, place in enumerate(term.where):
        found = _LOCATION.match(place)
        if found and found[1] not in tags:
            raise _damaged(source, f"{key}.where.{j}", f"there is no {place} on an arm of {len(tags)} axes")
    for j, part in enumerate(term.parts):
        _check_part(part, k, tags, source, f"{key}.parts.{j}")


def _check_part(part: DescribedPart, k: int, tags: tuple[str, ...], source: str, key: str) -> None:
    if part.place not in COMPONENTS:
        raise _damaged(source, f"{key}.place", f"'{part.place}' is none of {', '.join(COMPONENTS)}")
    axes = len(tags)
    last = {"joint": axes - 1, "frame": axes}.get(part.place)  # the others have no index
    if last is not None and not 0 <= part.index <= last:
        raise _damaged(source, f"{key}.index", f"{part.index} is not within 0 to {last}, as a {part.place} of an arm of {axes} axes is")
    if not 0 <= part.component < COMPONENTS[part.place]:
        raise _damaged(source, f"{key}.component", f"{part.component} is not within 0 to {COMPONENTS[part.place] - 1}")
    if len(part.columns) != k:
        raise _damaged(source, f"{key}.columns", f"{len(part.columns)} columns for {k} coefficients")
    for c, column in enumerate(part.columns):
        for p, product in enumerate(column):
            for f, function in enumerate(product.functions):
                _check_function(function, tags, source, f"{key}.columns.{c}.{p}.functions.{f}")


def _check_function(function: Function, tags: tuple[str, ...], source: str, key: str) -> None:
    for pattern, known in ((_OF_JOINT, tags), (_OF_FRAME, ("0", *tags))):
        found = pattern.match(function.covariate)
        if found and found[1] not in known:
            raise _damaged(source, f"{key}.of", f"there is no {function.covariate} on an arm of {len(tags)} axes")
    kind = FUNCTIONS.get(function.kind)
    if kind is None:
        raise ConfigError(f"{source}: {key}.kind: there is no function '{function.kind}'; if a newer mbcacq wrote it, update this one")
    count = kind.__code__.co_argcount - 1
    if len(function.numbers) != count:
        raise _damaged(source, f"{key}.numbers", f"'{function.kind}' has {count} numbers, here are {len(function.numbers)}")
    with np.errstate(all="ignore"):
        at_zero, beside = kind(np.array([0.0, 0.5]), *function.numbers)
        if np.isnan(at_zero) or not np.isfinite(beside):  # a width of zero, say; a power may have a pole
            raise _damaged(source, f"{key}.numbers", f"with these '{function.kind}' has no finite value")


def _damaged(source: str, key: str, fault: str) -> ConfigError:
    return damaged(source, f"{key}: {fault}", CURE)
