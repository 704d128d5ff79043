"""The catalogue of effects at standstill: every module in ``pose/`` with a NAME and ``candidates(context)``."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

from mbcacq.effects import pose
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing


def effects() -> dict[str, ModuleType]:
    """Name of the effect -> its module."""
    found = {}
    for info in pkgutil.iter_modules(pose.__path__):
        module = importlib.import_module(f"{pose.__name__}.{info.name}")
        if hasattr(module, "NAME") and hasattr(module, "candidates"):
            found[module.NAME] = module
    return found


def candidates(context: Context) -> tuple[list[Candidate], dict[str, str]]:
    """All candidates that these data allow, and the effects that they do not allow: name -> what is missing."""
    out, dropped = [], {}
    for name, module in effects().items():
        try:
            out += module.candidates(context)
        except Missing as reason:
            dropped[name] = str(reason)
    return out, dropped
