"""The catalogue of effects at standstill: every module in ``pose/`` with a NAME and ``candidates(context)``, and those of other packages.

A package adds effects by entry points of the group ``mbcacq.effects``, each of which names such a module.
"""

from __future__ import annotations

import importlib
import pkgutil
from importlib.metadata import entry_points
from types import ModuleType

from mbcacq.effects import pose
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing
from mbcacq.errors import ConfigError


def effects() -> dict[str, ModuleType]:
    """Name of the effect -> its module. Raises ConfigError where another package's module cannot be imported or is no effect."""
    found = {}
    for info in pkgutil.iter_modules(pose.__path__):
        module = importlib.import_module(f"{pose.__name__}.{info.name}")
        if hasattr(module, "NAME") and hasattr(module, "candidates"):
            found[module.NAME] = module
    for point in entry_points(group="mbcacq.effects"):
        try:
            module = point.load()
        except ImportError as error:
            raise ConfigError(
                f"the effect '{point.name}' ({point.value}) cannot be imported: {error}; mend or uninstall its package"
            ) from error
        if not (isinstance(getattr(module, "NAME", None), str) and callable(getattr(module, "candidates", None))):
            raise ConfigError(f"the effect '{point.name}': {point.value} is no module with NAME and candidates(context)")
        if module.NAME in found:
            raise ConfigError(f"the effect '{point.name}' ({point.value}) is called {module.NAME}, as another one is; rename it")
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
