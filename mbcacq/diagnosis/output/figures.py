"""Which figures of an effect are shown: those that are beyond their expanded uncertainty."""

from __future__ import annotations

from mbcacq.diagnosis.effect_found import NOT_SIZES
from mbcacq.effects.effect import ParameterEstimate, Parameters
from mbcacq.quantities import K, split_unit


def beyond_uncertainty(parameters: Parameters) -> tuple[dict[str, ParameterEstimate], list[str]]:
    """The parameters without what their expanded uncertainty (k = 2) covers, and what was left out in words.

    A vector is one quantity: it stays whole where one of its components is beyond its uncertainty. A harmonic of a periodic error is one
    as well: its order and phase go with its amplitude.
    """
    shown, below = dict[str, ParameterEstimate](), list[str]()
    for name, estimate in parameters.items():
        location, _, quantity = name.rpartition(".")
        amplitude = parameters.get(f"{location}.amplitude_deg")
        if amplitude is not None and quantity in ("order", "phase_deg", "amplitude_deg"):
            large = _large(amplitude)
            if any(large):
                shown[name] = estimate.only([k for k, is_large in enumerate(large) if is_large])
            if quantity == "order":
                below += [f"{location} order {estimate.only([k])}" for k, is_large in enumerate(large) if not is_large]
        elif quantity in NOT_SIZES or any(_large(estimate)):
            shown[name] = estimate
        else:
            below.append(split_unit(name)[0])
    return shown, below


def _large(estimate: ParameterEstimate) -> list[bool]:
    return [abs(v) >= K * s for v, s in zip(*estimate.components, strict=True)]
