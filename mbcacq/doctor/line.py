"""One line of a checkup: what is well, or what is not and how to cure it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mbcacq.model.json_text import AsJson

Level = Literal["ok", "warning", "error"]


@dataclass(frozen=True)
class CheckupLine(AsJson):
    """level: 'error' keeps a run from succeeding. topic: stable name for programs. cure: what to do, '' if all is well."""

    level: Level
    topic: str
    text: str
    cure: str = ""


def from_error(topic: str, error: BaseException | str, level: Level = "error") -> CheckupLine:
    """Our errors end with what to do about them, behind the last semicolon."""
    what, _, cure = str(error).rpartition("; ")
    return CheckupLine(level, topic, what or str(error), cure if what else "mend what the sentence names")
