"""Injected effects. Each effect is one small file; ``make`` builds it by the name of its file.

An effect is simulated in another way than it is identified: by equilibria, states and models in time, not by regressors. No catalogue of
the tool has the effects in UNCATALOGUED.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from mbcacq.errors import ConfigError
from mbcacq_fakes.effects.base import InjectedEffect

CATALOGUED = tuple(
    """
joint_compliance base_compliance mount_compliance gear_transmission_error backlash joint_scale axis_error_motion wrist_coupling
joint_step thermal_growth mount_shift scanner_scale scanner_distortion scanner_warmup ball_shift artefact_expansion station_drift
lost_motion hysteresis gravity_compensator incidence_bias payload exposure_latency joint_settling mount_clearance thermal_zero_shift
""".split()
)
UNCATALOGUED = tuple(
    """
axis_wobble cable_at_mount cable_drag floor_heave fringe_ripple hose_twist link_bending loose_anchor progressive_gear short_memory
sinking_pedestal spalled_raceway taut_hose tilting_camera uneven_ring warm_gearbox
""".split()
)


def make(name: str, strength: float = 1.0, seed: int | None = None, **options: Any) -> InjectedEffect:
    """strength 1 is plainly visible to a plan that can see it. Raises ConfigError for an unknown name or option."""
    if name not in CATALOGUED + UNCATALOGUED:
        raise ConfigError(f"fake.hidden: there is no effect '{name}' (known: {', '.join(CATALOGUED + UNCATALOGUED)}); correct the plan")
    module = import_module(f"mbcacq_fakes.effects.{name}")
    classes = (v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__)
    effect = next(v for v in classes if issubclass(v, InjectedEffect))
    return effect(name, strength, seed, options)
