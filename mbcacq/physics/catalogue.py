"""Finds the effect files of this package: every module with a NAME and ``candidates(situation)``."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

from mbcacq import physics
from mbcacq.physics.effect import Candidate, Missing
from mbcacq.physics.situation import Situation


def effects() -> dict[str, ModuleType]:
    """Name of the effect -> its module."""
    found = {}
    for info in pkgutil.iter_modules(physics.__path__):
        module = importlib.import_module(f"{physics.__name__}.{info.name}")
        if hasattr(module, "NAME") and hasattr(module, "candidates"):
            found[module.NAME] = module
    return found


def candidates(situation: Situation) -> tuple[list[Candidate], dict[str, str]]:
    """All candidates that these data allow, and the effects dropped: name -> what is missing."""
    out, dropped = [], {}
    for name, module in effects().items():
        try:
            out += module.candidates(situation)
        except Missing as reason:
            dropped[name] = str(reason)
    return out, dropped
