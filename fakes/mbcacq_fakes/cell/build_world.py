"""From a plan's ``fake:`` section to a world with its camera."""

from __future__ import annotations

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq_fakes.effects import make
from mbcacq_fakes.world.camera import ArmReadout, Camera
from mbcacq_fakes.world.description import CellFacts
from mbcacq_fakes.world.noise import NoiseGrowth, ScannerNoise
from mbcacq_fakes.world.operator import FakeOperator
from mbcacq_fakes.world.options import FakeOptions, arm_errors
from mbcacq_fakes.world.rays import Grid
from mbcacq_fakes.world.scanner import FringeScanner, Optics
from mbcacq_fakes.world.world import Deviations, World

USUAL_BALL_MM = 12.0


def make_world(facts: CellFacts, options: FakeOptions, seed: int) -> World:
    """The true cell. Raises ConfigError for an effect that does not exist."""
    seed = seed if options.seed is None else options.seed
    deviations = Deviations(
        errors=arm_errors(options, facts.n, seed),
        repeatability=np.full(facts.n, 1e-6 * options.repeatability_urad),
        hand_eye=None if options.hand_eye is None else options.hand_eye.transform(),
        hand_eye_mm=options.hand_eye_error.mm,
        hand_eye_rad=np.radians(options.hand_eye_error.deg),
        station_mm=options.station_error.mm,
        station_rad=np.radians(options.station_error.deg),
    )
    return World(facts, deviations, _effects(options), options.climate, seed, options.noise_seed)


def make_camera(  # noqa: PLR0913 -- one argument a part of the cell
    world: World,
    arm: ArmReadout,
    options: FakeOptions,
    planned_q: np.ndarray,
    planned_station: np.ndarray,
    right_exposure_us: float | None = None,
    clock_start_s: float = 0.0,
    optics: Optics | None = None,
    poses_before: int = 0,
) -> Camera:
    """planned_q (P, n) rad and planned_station (P,) index: the poses of the plan, by which the operator knows what comes next. optics: of
    the scanner; default: as a Gocator's. poses_before: measured in the same cell before it was started."""
    check(options, world.facts)
    view, ball = world.facts.view, smallest_ball(world.facts)
    growth = NoiseGrowth.stated(view, options.noise_mm, options.noise_far_mm, options.noise_factor_at_60_deg)
    noise = ScannerNoise.for_centres(np.array(options.noise_mm), options.speckle_mm, ball, growth)
    scanner = FringeScanner(Grid.with_pitch(view, options.pitch_mm), noise, optics or Optics())
    operator = FakeOperator(planned_q, planned_station, world.facts.station_artefact)
    return Camera(world, scanner, operator, arm, options, right_exposure_us, clock_start_s, poses_before=poses_before)


def smallest_ball(facts: CellFacts) -> float:
    """mm: over it the scanner's noise is nearly one shift; larger balls average it."""
    diameters = np.concatenate([a.diameters for a in facts.artefacts])
    return float(np.min(diameters[diameters > 0], initial=np.inf)) if np.any(diameters > 0) else USUAL_BALL_MM


def check(options: FakeOptions, facts: CellFacts) -> None:
    """Raises ConfigError for a mishap that names what the plan has not."""
    known = {"station": facts.station_ids, "artefact": tuple(a.id for a in facts.artefacts), "ball": facts.balls}
    for mishap in options.mishaps:
        for name, choices in known.items():
            value = getattr(mishap, name)
            if value is not None and (value if name == "ball" else str(value)) not in choices:
                raise ConfigError(f"fake.mishaps: there is no {name} '{value}' (known: {', '.join(map(str, choices))}); correct the plan")


def _effects(options: FakeOptions) -> list:
    if not options.hidden:
        return []
    return [make(**h.model_dump()) for h in options.hidden]
