"""The catalogue of effects: every module in ``kinds/`` with a NAME, and those of other packages.

An effect that shows in poses at standstill has ``candidates(context)``, one that shows in motion
``motion_candidates(group, runs)``, one that shows in both has both. ``DECLARED`` says what is particular about it.

A package adds effects by entry points of the group ``mbcacq.effects``, each of which names such a module; ``with_added`` adds files,
modules and functions for a while.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType, ModuleType, SimpleNamespace

from mbcacq.effects import kinds
from mbcacq.effects.context import Context
from mbcacq.effects.declaration import NOTHING_PARTICULAR, Declaration, EffectCoupling, PeriodicInMotion
from mbcacq.effects.effect import Candidate, Missing
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals
from mbcacq.errors import ConfigError

Added = Path | str | ModuleType | Callable[[Context], list[Candidate]]
Effect = ModuleType | SimpleNamespace
_added: ContextVar[Mapping[str, Effect]] = ContextVar("effects added for a while", default=MappingProxyType({}))


def effects() -> Mapping[str, Effect]:
    """Name of the effect -> its module. Raises ConfigError if another package's module cannot be imported or is no effect."""
    found, added = _effects(tuple(sys.path)), _added.get()
    return MappingProxyType({**found, **added}) if added else found


@cache
def _effects(where: tuple[str, ...]) -> Mapping[str, ModuleType]:
    """The same. where: the folders that packages are looked for in; looking takes 50 ms."""
    found = {}
    for info in pkgutil.iter_modules(kinds.__path__):
        module = importlib.import_module(f"{kinds.__name__}.{info.name}")
        found[module.NAME] = module
    for point in entry_points(group="mbcacq.effects"):
        module = _of_another_package(point)
        if module.NAME in found:
            raise ConfigError(f"the effect '{point.name}' ({point.value}) is called {module.NAME}, as another one is; rename it")
        found[module.NAME] = module
    return MappingProxyType(found)


@contextmanager
def with_added(some: Sequence[Added]) -> Iterator[None]:
    """While it lasts, these effects are in the catalogue too.

    some: files; modules, as ``kinds/`` has them; or functions of a context that return candidates, whose effect is called as the function
    is. Raises ConfigError if one is no effect, or is called as another effect is.
    """
    added = dict(_added.get())
    for one in some:
        effect, source = _of(one)
        if effect.NAME in added or effect.NAME in _effects(tuple(sys.path)):
            raise ConfigError(f"the effect of {source} is called {effect.NAME}, as another one is; rename it, or uninstall the other")
        added[effect.NAME] = effect
    token = _added.set(MappingProxyType(added))
    try:
        yield
    finally:
        _added.reset(token)


def _of(one: Added) -> tuple[Effect, str]:
    """The effect, and what a message calls its source."""
    if isinstance(one, Path | str):
        return _of_file(Path(one)), str(one)
    if _is_effect(one) and isinstance(one, ModuleType):
        return one, one.__name__
    if callable(one) and hasattr(one, "__name__"):
        return _of_function(one, one.__name__), f"the function {one.__name__}"
    raise ConfigError(
        f"{one!r} is no effect; give a function of a context that returns candidates, a module with NAME and candidates, or a file"
    )


def _of_function(function: Callable[[Context], list[Candidate]], name: str) -> SimpleNamespace:
    def candidates(context: Context) -> list[Candidate]:
        found = function(context)
        if not isinstance(found, list) or not all(isinstance(c, Candidate) for c in found):
            raise ConfigError(f"the function {name} is no effect: it returns no list of candidates; make them with plain_effect")
        if other := [c.name for c in found if c.name != name]:
            raise ConfigError(f"the function {name} makes candidates of an effect {other[0]}; call both the same")
        return found

    return SimpleNamespace(NAME=name, candidates=candidates)


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
        raise ConfigError(f"{file} is no effect: it needs NAME, and candidates(context) or motion_candidates(group, runs)")
    return module


def _is_effect(module: object) -> bool:
    shows = any(callable(getattr(module, name, None)) for name in ("candidates", "motion_candidates"))
    return isinstance(getattr(module, "NAME", None), str) and shows


def _of_another_package(point: EntryPoint) -> ModuleType:
    try:
        module = point.load()
    except ImportError as error:
        sentence = f"the effect '{point.name}' ({point.value}) cannot be imported: {error}; mend or uninstall its package"
        raise ConfigError(sentence) from error
    if not _is_effect(module):
        raise ConfigError(
            f"the effect '{point.name}': {point.value} is no module with NAME, and candidates(context) or motion_candidates(group, runs)"
        )
    return module


def declaration(name: str) -> Declaration:
    """The particulars of an effect, by its name; none for one that is not in the catalogue."""
    return getattr(effects().get(name), "DECLARED", NOTHING_PARTICULAR)


def couplings() -> tuple[EffectCoupling, ...]:
    """The couplings of all effects that show only through another one."""
    return tuple(c for name in effects() if (c := declaration(name).coupling) is not None)


def candidates(context: Context) -> tuple[list[Candidate], dict[str, str]]:
    """All candidates at standstill that these data allow, and the effects that they do not allow: name -> what is missing."""
    out, dropped = [], {}
    for name, module in effects().items():
        if not hasattr(module, "candidates"):
            continue
        try:
            found = module.candidates(context)
            _require_covariates(found, context)
        except Missing as reason:
            dropped[name] = str(reason)
            continue
        out += found if declaration(name).of_slides else [c for c in found if not _slides(c, context)]
    return out, dropped


def _slides(candidate: Candidate, context: Context) -> bool:
    """Whether a candidate displaces a prismatic joint, or is a function of one's position as if it were an angle."""
    parts = candidate.parts(None if candidate.hyper is None else float(candidate.hyper.values[0]))
    slides = context.state.chain.sliding
    angles = {f"{kind}{context.tags[j]}" for j in slides for kind in ("q", "movement_")}
    return any((p.place == "joint" and p.index in slides) or p.covariates & angles for p in parts) if slides else False


def _require_covariates(found: Sequence[Candidate], context: Context) -> None:
    """Raises Missing if the recording lacks a covariate of which one of the candidates is a function."""
    for candidate in found:
        first = None if candidate.hyper is None else float(candidate.hyper.values[0])
        for name in {name for part in candidate.parts(first) for name in part.covariates}:
            context.value(name)


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    """All candidates in motion for one group of channels."""
    return [c for module in effects().values() if hasattr(module, "motion_candidates") for c in module.motion_candidates(group, runs)]


def periodic_in(channel: str) -> tuple[str, PeriodicInMotion] | None:
    """The effect that is periodic in the angle of a joint in a channel of motion, and how; None if there is none."""
    found = [(name, p) for name in effects() if (p := declaration(name).periodic_in_motion) is not None and p.channel == channel]
    return found[0] if found else None
