"""The catalogue of effects at standstill: every module in ``pose/`` with a NAME and ``candidates(context)``, and those of other packages.

A package adds effects by entry points of the group ``mbcacq.effects``, each of which names such a module; ``with_files`` adds files.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType, ModuleType

from mbcacq.effects import pose
from mbcacq.effects.context import Context
from mbcacq.effects.declaration import NOTHING_PARTICULAR, Coupling, Declaration
from mbcacq.effects.effect import Candidate, Missing
from mbcacq.errors import ConfigError

_added: ContextVar[Mapping[str, ModuleType]] = ContextVar("effects of files", default=MappingProxyType({}))


def effects() -> Mapping[str, ModuleType]:
    """Name of the effect -> its module. Raises ConfigError where another package's module cannot be imported or is no effect."""
    return MappingProxyType({**_effects(tuple(sys.path)), **_added.get()})


@cache
def _effects(where: tuple[str, ...]) -> Mapping[str, ModuleType]:
    """The same. where: the folders that packages are looked for in; looking takes 50 ms."""
    found = {}
    for info in pkgutil.iter_modules(pose.__path__):
        module = importlib.import_module(f"{pose.__name__}.{info.name}")
        if hasattr(module, "NAME") and hasattr(module, "candidates"):
            found[module.NAME] = module
    for point in entry_points(group="mbcacq.effects"):
        module = _of_another_package(point)
        if module.NAME in found:
            raise ConfigError(f"the effect '{point.name}' ({point.value}) is called {module.NAME}, as another one is; rename it")
        found[module.NAME] = module
    return MappingProxyType(found)


@contextmanager
def with_files(files: Sequence[Path | str]) -> Iterator[None]:
    """While it lasts, the effects of these files are in the catalogue too.

    Raises ConfigError where a file is no effect, or is called as another effect is.
    """
    added = dict(_added.get())
    for file in files:
        module = _of_file(Path(file))
        if module.NAME in added or module.NAME in _effects(tuple(sys.path)):
            raise ConfigError(f"the effect of {file} is called {module.NAME}, as another one is; rename it, or uninstall the other")
        added[module.NAME] = module
    token = _added.set(MappingProxyType(added))
    try:
        yield
    finally:
        _added.reset(token)


def _of_file(file: Path) -> ModuleType:
    # It does not enter sys.modules: then worker processes get its functions by value, as they cannot import it.
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None or not file.is_file():
        raise ConfigError(f"{file} is no Python file with an effect; give the module that --propose wrote, or one like it")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # noqa: BLE001 -- whatever a user's file raises
        raise ConfigError(f"{file} cannot be read as an effect ({type(error).__name__}: {error}); correct it") from error
    if not _is_effect(module):
        raise ConfigError(f"{file} is no effect: it needs NAME and candidates(context)")
    return module


def _is_effect(module: object) -> bool:
    return isinstance(getattr(module, "NAME", None), str) and callable(getattr(module, "candidates", None))


def _of_another_package(point: EntryPoint) -> ModuleType:
    try:
        module = point.load()
    except ImportError as error:
        sentence = f"the effect '{point.name}' ({point.value}) cannot be imported: {error}; mend or uninstall its package"
        raise ConfigError(sentence) from error
    if not _is_effect(module):
        raise ConfigError(f"the effect '{point.name}': {point.value} is no module with NAME and candidates(context)")
    return module


def declaration(name: str) -> Declaration:
    """What is particular about an effect, by its name; nothing for one that is not in the catalogue."""
    return getattr(effects().get(name), "DECLARED", NOTHING_PARTICULAR)


def couplings() -> tuple[Coupling, ...]:
    """Of all effects that show only through another one."""
    return tuple(c for name in effects() if (c := declaration(name).coupling) is not None)


def candidates(context: Context) -> tuple[list[Candidate], dict[str, str]]:
    """All candidates that these data allow, and the effects that they do not allow: name -> what is missing."""
    out, dropped = [], {}
    for name, module in effects().items():
        try:
            out += module.candidates(context)
        except Missing as reason:
            dropped[name] = str(reason)
    return out, dropped
