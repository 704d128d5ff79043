"""Finds drivers by their entry points."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any

from mbcacq.errors import ConfigError


def _registered(kind: str) -> EntryPoints:
    """The entry points of a kind. To read those of every installed package takes as long as to import a driver, and a run asks often."""
    return _read(kind, tuple((folder, _changed_ns(folder)) for folder in sys.path))


def _changed_ns(folder: str) -> int:
    try:
        return os.stat(folder or ".").st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=16)
def _read(kind: str, folders: tuple[tuple[str, int], ...]) -> EntryPoints:
    """folders: what is searched, and when a package came or went there."""
    return entry_points(group=f"mbcacq.{kind}")


def available(kind: str) -> dict[str, str]:
    """Names and targets of the registered drivers of a kind: 'robots', 'scanners', 'positioners', 'sensors' or 'fakes'."""
    return {point.name: point.value for point in _registered(kind)}


def load_driver(kind: str, name: str) -> type:
    """The class registered under ``name`` (kuka-eki is kuka_eki), imported only now. Raises ConfigError naming the choices."""
    plain = name.replace("-", "_")
    points = {point.value: point for point in _registered(kind) if point.name.replace("-", "_") == plain}
    if len(points) > 1:
        raise ConfigError(
            f"driver '{name}' is registered {len(points)} times among the {kind} ({', '.join(sorted(points))}); uninstall "
            "all packages but one of them"
        )
    for point in points.values():
        try:
            return point.load()
        except ImportError as error:
            raise ConfigError(f"driver '{name}' ({point.value}) cannot be imported: {error}; {cure_of(point, error)}") from error
    choices = ", ".join(sorted(available(kind))) or "none"
    raise ConfigError(f"there is no driver '{name}' among the {kind} (installed: {choices}); correct the name or install its package")


def cure_of(point: EntryPoint, error: Exception) -> str:
    """What to install: the extra of the driver's package that brings the missing module, where there is one."""
    if not isinstance(error, ImportError) or point.dist is None:
        return "reinstall its package, with what it needs"
    name = re.escape(error.name or " ")
    for line in point.dist.requires or ():
        extra = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", line)
        if extra and re.match(rf"{name}(?![\w-])", line) and extra[1] not in ("test", "dev"):
            return f"install what it needs: pip install '{point.dist.name}[{extra[1]}]'"
    return "install what it needs"


def create(kind: str, name: str, model: str, options: Mapping[str, Any]) -> Any:
    """Construct a driver: ``model`` is what the device must identify as ('' for any), ``options`` the plan's own for it."""
    return load_driver(kind, name)(name, model, dict(options))
