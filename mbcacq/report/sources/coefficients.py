"""Names of the coefficients of effects, as a result has them, in words."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from mbcacq.diagnosis.output.pictures import axis_of
from mbcacq.quantities import significant, split_unit, with_unit
from mbcacq.report.verdict import readable

COEFFICIENT = re.compile(r"(?P<effect>[^:]+):(?P<where>[^:]*):(?P<rest>.*?)(?:\[(?P<number>\d+)\])?")


def names_in_words(names: Sequence[str]) -> list[str]:
    """Each of the names of parameters, those of effects in words: 'scanner_warmup:scanner:time:time_constant_s=177.9[0]' becomes 'scanner
    warmup at scanner, time constant 178 s (1)'. The covariate is added where two would be called the same."""
    short = [_in_words(name, False) for name in names]
    often = Counter(short)
    return [_in_words(name, True) if often[said] > 1 else said for name, said in zip(names, short, strict=True)]


def _in_words(name: str, covariate: bool) -> str:
    found = COEFFICIENT.fullmatch(name)
    if found is None:
        return name
    out = [f"{readable(found['effect'])} at {found['where']}"]
    for part in found["rest"].split(":"):
        key, equals, value = part.partition("=")
        if equals:
            words, unit, factor = split_unit(key)
            out.append(f"{words} {with_unit(_number(value, factor), unit)}")
        elif covariate and part:
            out.append(f"over {axis_of(part)[0]}")
    number = "" if found["number"] is None else f" ({int(found['number']) + 1})"
    return ", ".join(out) + number


def _number(value: str, factor: float) -> str:
    try:
        return f"{factor * float(value):g}" if float(value).is_integer() else significant(factor * float(value))
    except ValueError:
        return value
