"""Named blocks of parameters: what each is called, its unit, whether it is free, why not, and its prior.

The vector a solver works on is the free entries of all blocks, one after another; station poses are not in it (they are
eliminated, six each).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import ArmPrior, CalibrationOptions
from mbcacq.estimation.terms import Term
from mbcacq.geometry import se3
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.model.cell import TARGET_IN_BASE, Cell, RobotModel, link_parameters
from mbcacq.model.observations import Observations

HAND_EYE = ("x", "y", "z", "rx", "ry", "rz")
# Size that an error of each kind may plausibly have; scales the parameters for the rank check and says what "undetermined" means.
PLAUSIBLE = {"theta": 0.02, "d": 3.0, "a": 3.0, "alpha": 0.01, "beta": 0.01}
PLAUSIBLE_HAND_EYE = np.array([30.0, 30.0, 30.0, 0.2, 0.2, 0.2])
UNDETERMINED = 1.5  # standard deviation of a direction, in such sizes, beyond which it counts as undetermined
# Groups of random effects whose common size is estimated: the links' errors of an arm that is not to be identified.
LENGTHS, ANGLES = "link lengths", "link angles"
LINK_GROUP = {"theta": ANGLES, "d": LENGTHS, "a": LENGTHS, "alpha": ANGLES, "beta": ANGLES}
# sigma at the start, far larger than arms have (0.1 to 0.3 mm, 0.3 to 0.5 mrad): sizes that begin small may stay there.
LINK_START = {LENGTHS: 1.0, ANGLES: 3e-3}
# Sizes of an industrial arm as it is delivered (absolute accuracy 0.5 to 1 mm), as a factor of the sigma at the start: 0.2 mm, 0.5 mrad.
ORDINARY_LINKS = {LENGTHS: 0.2 / LINK_START[LENGTHS], ANGLES: 5e-4 / LINK_START[ANGLES]}
# Kinds of errors of an arm that is identified, which have a size in common: a joint's zero is set when it is mastered, the rest when the
# arm is built. Sizes at the start as above.
KINDS = {"theta": "joint zeros", "alpha": "link twists", "beta": "link twists", "d": "lengths", "a": "lengths"}
KINDS_START = {"joint zeros": 1e-2, "link twists": 3e-3, "lengths": 1.0}
LEAST_OF_A_KIND = 3  # fewer free parameters say nothing of a common size and stay without one
USUAL_ANGLE, USUAL_SHARE = 5e-4, 2e-4  # rad; of the reach: an arm of 1 m errs by 0.2 mm in its lengths


@dataclass(frozen=True)
class ParameterBlock:
    """k parameters of one kind. names, units: (k,); free: (k,) bool; sigma: (k,) prior about ``centre``, inf = none; scale: (k,) plausible
    size; why: reason of each held one; centre: (k,) of the prior of the errors, None: zero; group: (k,) name of the random effects whose
    common size is estimated and multiplies sigma, '' for a parameter with a sigma of its own; None: none is estimated."""

    name: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    free: np.ndarray
    sigma: np.ndarray
    scale: np.ndarray
    why: dict[str, str] = field(default_factory=dict)
    centre: np.ndarray | None = None
    group: tuple[str, ...] | None = None

    def hold(self, index: int, why: str) -> ParameterBlock:
        free = self.free.copy()
        free[index] = False
        return replace(self, free=free, why={**self.why, self.names[index]: why})


@dataclass(frozen=True)
class ParameterLayout:
    """The blocks of a problem: chain (5 n, row by row), hand_eye (6), balls (3 K), then one per term."""

    blocks: tuple[ParameterBlock, ...]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of the solver's vector."""
        return tuple(name for b in self.blocks for name, free in zip(b.names, b.free, strict=True) if free)

    @cached_property
    def size(self) -> int:
        return sum(int(b.free.sum()) for b in self.blocks)

    @cached_property
    def sigma(self) -> np.ndarray:
        """(g,) of the free parameters."""
        return np.concatenate([b.sigma[b.free] for b in self.blocks])

    @cached_property
    def scale(self) -> np.ndarray:
        """(g,) of the free parameters."""
        return np.concatenate([b.scale[b.free] for b in self.blocks])

    @cached_property
    def sized(self) -> dict[str, np.ndarray]:
        """Groups of random effects whose size is estimated: their indices in the solver's vector by name."""
        names = [g for b in self.blocks for g, free in zip(b.group or ("",) * len(b.names), b.free, strict=True) if free]
        return {name: np.flatnonzero(np.array(names) == name) for name in dict.fromkeys(names) if name}

    def resized(self, factor: Mapping[str, float]) -> ParameterLayout:
        """The layout with the sigma of each named group multiplied."""
        blocks = []
        for b in self.blocks:
            if b.group is not None:
                b = replace(b, sigma=b.sigma * np.array([factor.get(g, 1.0) for g in b.group]))
            blocks.append(b)
        return ParameterLayout(tuple(blocks))

    @cached_property
    def link_kinds(self) -> tuple[str, ...]:
        """Kinds of link errors that may have a size in common; none where the links have a prior of their own."""
        chain = self.blocks[0]
        if chain.group is not None or np.isfinite(chain.sigma[chain.free]).any():
            return ()
        kind = np.array([KINDS[p] for p in PARAMETERS] * (len(chain.names) // len(PARAMETERS)))
        return tuple(name for name in KINDS_START if np.sum(chain.free & (kind == name)) >= LEAST_OF_A_KIND)

    @cached_property
    def turning(self) -> np.ndarray:
        """Which of the free parameters of arm and hand-eye, the first of the solver's vector, are rotations (bool)."""
        return np.array([unit == "rad" for b in self.blocks[:2] for unit, free in zip(b.units, b.free, strict=True) if free], dtype=bool)

    def spread(self, step: np.ndarray) -> list[np.ndarray]:
        """The solver's vector (g,) as one full array per block, zero where held."""
        out, start = [], 0
        for b in self.blocks:
            full = np.zeros(len(b.names))
            count = int(b.free.sum())
            full[b.free] = step[start : start + count]
            out.append(full)
            start += count
        return out

    def hold(self, name: str, why: str) -> ParameterLayout:
        """The layout with one more parameter held. Raises ConfigError if there is no such parameter."""
        for i, b in enumerate(self.blocks):
            if name in b.names:
                return ParameterLayout((*self.blocks[:i], b.hold(b.names.index(name), why), *self.blocks[i + 1 :]))
        raise ConfigError(f"there is no parameter '{name}'; give one of {', '.join(n for b in self.blocks[:2] for n in b.names)}")

    def holding(self, held: Mapping[str, str]) -> ParameterLayout:
        """The layout with these parameters held as well, for these reasons."""
        layout = self
        for name, why in held.items():
            layout = layout if name in layout.held else layout.hold(name, why)
        return layout

    @property
    def held(self) -> dict[str, str]:
        """Held parameters with the reason, except balls that are simply taken as certified."""
        return {name: b.why[name] for b in self.blocks for name, free in zip(b.names, b.free, strict=True) if not free and name in b.why}


def build(obs: Observations, options: CalibrationOptions) -> ParameterLayout:
    """The layout for a recording: which parameters are free, with gauge and redundancy removed by what is known of every arm.

    theta_1 and d_1 move base and stations together; the last link moves the hand-eye transform; where axis i and i+1 are parallel, d_i
    acts like d_(i+1) and beta_i is needed; elsewhere beta_i acts like the neighbours' parameters. A prismatic joint has a direction and no
    place, so that two more parameters act like others.
    """
    cell = obs.cell
    blocks = [_chain(cell, options), _hand_eye(obs), _balls(obs, options)]
    layout = ParameterLayout((*blocks, *(term_block(t) for t in options.terms)))
    for name in options.hold:
        layout = layout.hold(name, "held on request")
    return layout


def _chain(cell: Cell, options: CalibrationOptions) -> ParameterBlock:
    chain, n = cell.robot.chain, cell.robot.n
    names = link_parameters(cell.robot.axes)
    why: dict[str, str] = {}
    uncertain = not options.kinematics and options.discrepancy and not cell.robot.of_flange_poses  # those have no links of their own
    if not options.kinematics and not uncertain:
        why = dict.fromkeys(names, "kinematics not asked for")
    else:
        redundant = chain.redundant(base_known=any(s.T_base_station is not None for s in cell.stations))
        why = {names[len(PARAMETERS) * i + k]: _acts_like(cell.robot, i, PARAMETERS[k]) for i, k in np.argwhere(redundant).tolist()}
        for name in options.release:
            why.pop(name, None)
    free = np.array([name not in why for name in names])
    scale = np.tile([PLAUSIBLE[p] for p in PARAMETERS], n)
    units = ("rad", "mm", "mm", "rad", "rad") * n
    prior = arm_prior(cell, options)
    if prior is None and uncertain:
        group = tuple(LINK_GROUP[p] for p in PARAMETERS) * n
        start = np.array([LINK_START[g] for g in group])
        return ParameterBlock("chain", names, units, free, start, scale, why, group=group)
    if prior is None:
        return ParameterBlock("chain", names, units, free, np.full(5 * n, np.inf), scale, why)
    return ParameterBlock("chain", names, units, free, prior.sigma.reshape(-1), scale, why, centre=prior.mean.reshape(-1))


def _acts_like(robot: RobotModel, i: int, parameter: str) -> str:
    """Why a parameter of row i is redundant."""
    chain, axes = robot.chain, robot.axes
    if i == chain.n - 1:
        return "acts like the hand-eye transform"
    if i == 0 and parameter in ("theta", "d"):
        return "moves the base together with the stations"
    if parameter == "d" and chain.parallel_next()[i]:
        return f"acts like d_{robot.tags[i + 1]}: axes {axes[i]} and {axes[i + 1]} are parallel"
    if parameter == "beta":
        return "acts like its neighbours, except between parallel axes"
    return "acts like others: of a prismatic joint the direction alone matters"


def usual_sizes(cell: Cell) -> dict[str, float]:
    """sigma (rad, mm) that each kind of errors usually has in an arm of this size that is to be identified."""
    length = USUAL_SHARE * 2 * float(cell.robot.chain.lever.max())
    return {kind: length if kind == "lengths" else USUAL_ANGLE for kind in KINDS_START}


def with_common_sizes(layout: ParameterLayout, sizes: Mapping[str, float] = KINDS_START) -> ParameterLayout:
    """The layout with random errors of the links.

    Parameters
    ----------
    layout : ParameterLayout
        Layout of an arm that is to be identified.
    sizes : mapping
        sigma (mm, rad) of each kind of error.

    Returns
    -------
    ParameterLayout
        The same where the links have a prior of their own, or too few of them are free.
    """
    if not layout.link_kinds:
        return layout
    chain = layout.blocks[0]
    kind = [KINDS[p] for p in PARAMETERS] * (len(chain.names) // len(PARAMETERS))
    group = tuple(name if name in layout.link_kinds else "" for name in kind)
    sigma = np.array([sizes[g] if g else np.inf for g in group])
    block: ParameterBlock = replace(chain, sigma=sigma, group=group)
    return ParameterLayout((block, *layout.blocks[1:]))


def arm_prior(cell: Cell, options: CalibrationOptions) -> ArmPrior | None:
    """The prior of the cell's type of arm; None where none was asked for. Raises ConfigError where there is none of this type."""
    if not options.priors:
        return None
    rows = cell.robot.chain.rows
    for prior in options.priors:
        if prior.nominal.shape == rows.shape and np.allclose(prior.nominal, rows, rtol=0, atol=1e-9):
            return prior
    known = ", ".join(sorted({prior.robot for prior in options.priors}))
    raise ConfigError(f"the prior knows no arm with the nominal geometry of '{cell.robot.name}' (it knows {known}); leave --prior out")


def hand_eye_names(obs: Observations) -> tuple[str, ...]:
    """Names of the parameters of the hand-eye transform, of several recordings of each."""
    of = [""] if obs.n_recordings == 1 else [f"[{r + 1}]" for r in range(obs.n_recordings)]
    return tuple(f"hand_eye{which}.{c}" for which in of for c in HAND_EYE)


def _hand_eye(obs: Observations) -> ParameterBlock:
    count, names = obs.n_recordings, hand_eye_names(obs)
    units, scale = (("mm",) * 3 + ("rad",) * 3) * count, np.tile(PLAUSIBLE_HAND_EYE, count)
    block = ParameterBlock("hand_eye", names, units, np.ones(6 * count, bool), np.full(6 * count, np.inf), scale)
    if obs.cell.measurement == TARGET_IN_BASE:
        unobservable = not obs.shows_target_orientation
        reason = "only the target's position is measured"
    else:
        unobservable = bool(np.abs(obs.xyz).max(initial=0.0) < 1e-9)
        reason = "only points at the scanner's origin are measured"
    for i in np.flatnonzero(np.arange(6 * count) % 6 >= 3) if unobservable else ():
        block = block.hold(int(i), reason)
    return block


def _balls(obs: Observations, options: CalibrationOptions) -> ParameterBlock:
    cell = obs.cell
    ids = cell.ball_ids
    names = tuple(f"ball_{b}.{c}" for b in ids for c in "xyz")
    sigma = np.array([a.uncertainty_mm for a in cell.artefacts])[cell.ball_artefact]
    measured = np.isin(np.arange(len(ids)), obs.ball)
    several = np.bincount(cell.ball_artefact, minlength=len(cell.artefacts))[cell.ball_artefact] > 1
    free = measured & several & (sigma > 0) & options.balls
    return ParameterBlock(
        "balls", names, ("mm",) * len(names), np.repeat(free, 3), np.repeat(sigma, 3), np.repeat(np.maximum(sigma, 1e-4), 3)
    )


def term_block(term: Term) -> ParameterBlock:
    """The block of a term's coefficients, all free."""
    scale = np.where(np.isfinite(term.sigma), term.sigma, 1.0)
    return ParameterBlock(term.name, term.names, term.units, np.ones(term.size, bool), term.sigma, scale)


@dataclass(frozen=True)
class Estimate:
    """A point of the parameter space: the cell's state and the coefficients of the terms."""

    state: CellState
    coefficients: tuple[np.ndarray, ...] = ()

    def moved(self, layout: ParameterLayout, step: np.ndarray, moves: np.ndarray, stations: np.ndarray | slice = slice(None)) -> Estimate:
        """After a step (g,) of the free parameters and local twists (S', 6) of some stations, of all if not said."""
        twists = np.zeros((len(self.state.T_base_station), 6))
        twists[stations] = moves
        chain_step, mount_step, ball_step, *term_steps = layout.spread(step)
        state = self.state
        chain, balls = state.chain.with_errors(chain_step.reshape(-1, 5)), state.balls + ball_step.reshape(-1, 3)
        mount = state.T_flange_scanner @ se3.exp(mount_step.reshape(*state.T_flange_scanner.shape[:-2], 6))
        moved = CellState(chain, mount, state.T_base_station @ se3.exp(twists), balls)
        return Estimate(moved, tuple(c + s for c, s in zip(self.coefficients, term_steps, strict=True)))
