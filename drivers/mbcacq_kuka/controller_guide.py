"""The short guide that goes with the files for the controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from mbcacq_kuka.eki.options import EkiOptions as EkiOptions
from mbcacq_kuka.rsi.options import RsiOptions as RsiOptions

_OUTPUTS = """
OUTPUTS
  mbcacq switches {named}, and no other. No other program may set it,
  and it must not be write-protected.
  {off}
"""


def eki_guide(options: EkiOptions, facts: Mapping[str, Any], warnings: Sequence[str] = ()) -> str:
    """The text of controller/eki_guide.txt for a plan's options."""
    first = options.first_flag
    off = "It goes off with whatever stops the arm, an emergency stop too: the link program sees to it."
    values = {
        "first_flag": first,
        "last_flag": first + 4,
        "waiting_flag": first + 2,
        **{name: getattr(options, name) for name in ("address", "port", "tool", "base", "controller_silence_ms")},
        "mode": " or ".join(options.mode),
        "override": options.override or "any",
        "outputs": _outputs(options.digital_outputs, off),
    }
    return _filled("eki_guide.txt", values, facts, warnings)


def rsi_guide(options: RsiOptions, facts: Mapping[str, Any], reach: Sequence[float], warnings: Sequence[str] = ()) -> str:
    """The text of controller/rsi_guide.txt for a plan's options. reach: largest correction of each axis, deg."""
    off = (
        "It goes off with a missing answer, and before and after RSI. An emergency stop while\n  it is on leaves it on until "
        "mbcacq_rsi is started again. Copy all files of a folder\n  together: context, Ethernet file and program."
    )
    far = ", ".join(f"{v:g}" for v in reach)
    values = {"bind": options.bind, "port": options.port, "far": far, "outputs": _outputs(options.digital_outputs, off)}
    return _filled("rsi_guide.txt", values, facts, warnings)


def _filled(name: str, values: Mapping[str, Any], facts: Mapping[str, Any], warnings: Sequence[str]) -> str:
    clean = {key: str(facts.get(key, "-")).encode("ascii", "replace").decode() for key in ("plan", "robot")}
    section = "".join(f"  {text}\n" for text in warnings)
    text = (files("mbcacq_kuka") / "controller" / name).read_text(encoding="ascii")
    return text.format(**values, **clean, warnings=f"\nWARNINGS\n{section}" if warnings else "")


def _outputs(numbers: Sequence[int], off: str) -> str:
    return _OUTPUTS.format(named=", ".join(f"$OUT[{number}]" for number in numbers), off=off) if numbers else ""
