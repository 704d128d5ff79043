"""Which $FLAGs the programs on the controller use, and whether somebody else uses them, too."""

from __future__ import annotations

import re
from collections.abc import Mapping

from mbcacq.devices import ConfigError

FIRST, COUNT = 120, 5  # in the files as they are shipped
LARGEST = 1025
OTHERS = {1: "the RSI context (connection interrupted)", 105: "KUKA's EKI server (connected)", 110: "KUKA's EKI server (telegram arrived)"}
_USES = re.compile(r'(?<=\$FLAG\[)\d+(?=\])|(?<=Set_Flag=")\d+(?=")')


def flags_in(text: str) -> set[int]:
    """Numbers of the flags that a program or a configuration of EKI names."""
    return {int(number) for number in _USES.findall(text)}


def with_flags_from(first: int, files: Mapping[str, str]) -> dict[str, str]:
    """The files with their five flags numbered from ``first`` on. Raises ConfigError if another program uses one of them."""
    for number in range(first, first + COUNT):
        if number in OTHERS:
            raise ConfigError(
                f"option first_flag is {first}, so the files would use $FLAG[{first}] to $FLAG[{first + COUNT - 1}], but $FLAG[{number}] "
                f"belongs to {OTHERS[number]}; choose another one, as {FIRST}"
            )
    moved = {name: _USES.sub(lambda m: str(int(m[0]) - FIRST + first), text) for name, text in files.items()}
    _check(moved, range(first, first + COUNT))
    return moved


def _check(files: Mapping[str, str], ours: range) -> None:
    """Raises AssertionError if a file uses a flag that it should not."""
    for name, text in files.items():
        if strange := flags_in(text) - set(ours):
            raise AssertionError(f"{name} uses $FLAG[{min(strange)}], which is none of its own")
