"""Which effects are a trend, and no finding with a figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from mbcacq.quantities import K

NOT_SIZES = ("order", "phase_deg", "at_pose", "time_constant_s", "transition_Nm", "breakpoint_Nm", "zero_deg")
UNCERTAIN = "no figure is beyond its expanded uncertainty (k = 2)"
REMOVES_NOTHING = "held-out data are predicted as well without it"
NOTHING = 0.0005  # a share that is written as 0.0 %


def trend(parameters: Mapping[str, tuple[Iterable[float | None], Iterable[float | None]]], gain: float | None, std: float = 0.0) -> str:
    """Why an effect is a trend: none of its sizes, or not what it removes, reaches its expanded uncertainty. Empty for a finding.

    parameters: by name, the values of its components and their standard deviations. gain, std: share of the held-out excess over the
    noise that it removes, None or not a number where it is not known, and its standard deviation.
    """
    sizes = [pairs for name, pairs in parameters.items() if name.rpartition(".")[2] not in NOT_SIZES]
    known = [(v, s) for values, stds in sizes for v, s in zip(values, stds, strict=False) if v is not None and s]
    if known and all(abs(v) < K * s for v, s in known):
        return UNCERTAIN
    return REMOVES_NOTHING if gain is not None and gain < max(K * std, NOTHING) else ""
