"""xacro expanded without ROS: packages are found by their package.xml above the file, or named."""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from defusedxml import ElementTree

from mbcacq.errors import ConfigError

PACKAGE, MOST_BYTES = "package.xml", 1 << 20
MOST_FOLDERS, DEEPEST = 4000, 3  # looked through for packages beside one that is found, a repository of a maker has a few hundred
NEAR, SHORTEST_NAME = 5, 5  # folders above the file; letters of the name of one that is taken for a package with a longer name
_MACRO = re.compile(rb"""<xacro:macro\s[^>]*?\bname\s*=\s*["']([^"']+)""")
STATEMENTS = ("include", "macro", "property")
BEFORE_2014 = "as xacro wrote it before 2014; put xacro: before these names"
_OURS = "mbcacq: "  # before sentences of ours that pass through xacro


def expanded(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> bytes:
    """The URDF that xacro makes of a file.

    packages: folder of each package that is not found above the file. arguments: values of ``$(arg name)``. Raises ConfigError.
    """
    try:
        xacro: Any = import_module("xacro")
    except ImportError:
        raise ConfigError(
            f"{path}: xacro is not installed; run `xacro {path.name} > {path.stem.removesuffix('.urdf')}.urdf` where ROS is "
            "and import that, or pip install 'mbcacq[xacro]'"
        ) from None
    finder = _Packages(path, packages)
    xacro.filestack = None  # of a file that it could not expand, xacro keeps the stack
    try:
        with _found_by(finder), contextlib.redirect_stderr(io.StringIO()):
            return xacro.process_file(str(path), mappings=dict(arguments)).toxml().encode("utf-8")
    except Exception as error:  # xacro raises many kinds, also those of the expressions in the file
        raise ConfigError(f"{path}: {_reason(error, xacro, path)}") from None


def _unprefixed(path: Path) -> str:
    """The first statement of xacro that a file writes without the prefix, '' if there is none."""
    with contextlib.suppress(OSError, SyntaxError, ValueError):  # ParseError is a SyntaxError, what defusedxml refuses a ValueError
        root = ElementTree.fromstring(path.read_bytes())
        return next((name for name in STATEMENTS if root.find(name) is not None), "")
    return ""


def macros(data: bytes) -> list[str]:
    """Names of the macros that a file defines."""
    return [name.decode("utf-8", "replace") for name in _MACRO.findall(data)]


def _reason(error: Exception, xacro: Any, path: Path) -> str:
    said = str(error)
    if _OURS in said:
        return said.split(_OURS)[1].splitlines()[0].strip()
    name = str(error.args[0]) if error.args else ""
    if type(error).__name__ == "ArgException" or (undefined := re.search(r"Undefined substitution argument (\S+)", said)):
        name = name if type(error).__name__ == "ArgException" else undefined[1]  # type: ignore[possibly-unbound]
        return f"xacro needs an argument '{name}'; give it by --arg {name}=VALUE"
    where = [f for f in xacro.filestack or () if f and Path(f).resolve() != path.resolve()]
    for file in (path, *(Path(path.parent, f) for f in getattr(xacro, "all_includes", ()))):
        if old := _unprefixed(file):
            return f"has <{old}> without 'xacro:'{'' if file is path else f' (in {file})'}, {BEFORE_2014}"
    return f"xacro cannot expand it{f' (in {where[-1]})' if where else ''}: {said.splitlines()[0] if said else type(error).__name__}"


@contextlib.contextmanager
def _found_by(finder: _Packages) -> Iterator[None]:
    """xacro asks ament_index_python for the folder of a package; a module of that name answers while the file is expanded."""
    names = ("ament_index_python", "ament_index_python.packages")
    before = {name: sys.modules.get(name) for name in names}
    top, own = (ModuleType(name) for name in names)
    own.get_package_share_directory = finder.folder  # type: ignore[attr-defined]
    top.packages = own  # type: ignore[attr-defined]
    sys.modules.update(zip(names, (top, own), strict=True))
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


class _Packages:
    """Folders of packages: named ones, those above the file with their neighbours, and those in the environment of ROS."""

    def __init__(self, path: Path, named: Mapping[str, Path]) -> None:
        self._path, self._named = path.resolve(), named
        self._seen: dict[str, Path] | None = None

    def folder(self, package: str) -> str:
        if package in self._named:
            folder = Path(self._named[package])
            if not folder.is_dir():
                raise ConfigError(f"{_OURS}--package {package}={folder}: there is no such folder; correct it")
            return str(folder.resolve())
        if self._seen is None:
            self._seen = dict(self._around())
        found = self._seen.get(package) or _of_ros(package)
        found = found or self._by_folder(package)
        if found is None:
            raise ConfigError(
                f"{_OURS}package '{package}' is not found above the file or beside it; say where by --package {package}=DIR, "
                "or expand the file where its packages are installed"
            )
        return str(found)

    def _by_folder(self, package: str) -> Path | None:
        """A package that was copied without its package.xml is recognised by its folder, above the file or beside such folders. The name of
        a folder above may also be the beginning of the package's (kuka_kr6 for kuka_kr6_support), or the reverse."""
        near = self._path.parents[:NEAR]
        beside = (f / package for f in near)
        alike = (f for f in near if len(f.name) >= SHORTEST_NAME and (package.startswith(f"{f.name}_") or f.name.startswith(f"{package}_")))
        return next((f for f in near if f.name == package), None) or next((f for f in beside if f.is_dir()), None) or next(alike, None)

    def _around(self) -> Iterator[tuple[str, Path]]:
        """Packages by name. The nearest come last: first those in the folders above the outermost package, then those above the file."""
        above = [f for f in self._path.parents if (f / PACKAGE).is_file()]
        if above:
            outermost = above[-1].parent
            for folder in _folders(outermost):
                if (folder / PACKAGE).is_file() and (name := _name(folder / PACKAGE)):
                    yield name, folder
        for folder in reversed(above):
            if name := _name(folder / PACKAGE):
                yield name, folder


def _folders(top: Path) -> Iterator[Path]:
    """Folders below one, a few deep, those that can be read."""
    count, level = 0, [top]
    for _ in range(DEEPEST):
        following: list[Path] = []
        for folder in level:
            with contextlib.suppress(OSError):
                following += sorted(Path(e.path) for e in os.scandir(folder) if e.is_dir(follow_symlinks=False) and e.name[0] != ".")
        for folder in following:
            count += 1
            if count > MOST_FOLDERS:
                return
            yield folder
        level = following


def _name(path: Path) -> str:
    """The name in a package.xml, '' if it has none."""
    try:
        with path.open("rb") as file:
            return (ElementTree.fromstring(file.read(MOST_BYTES)).findtext("name") or "").strip()
    except (OSError, SyntaxError, ValueError):  # ParseError is a SyntaxError, what defusedxml refuses a ValueError
        return ""


def _of_ros(package: str) -> Path | None:
    """Where an installed ROS has a package."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and (folder := Path(prefix) / "share" / package).is_dir():
            return folder
    for top in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if top and (folder := Path(top) / package).is_dir():
            return folder
    return None
