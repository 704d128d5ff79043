"""The plans, robots and artefacts that come with the tool: inside the package once installed, beside it in a source tree."""

from __future__ import annotations

from pathlib import Path

from mbcacq.errors import ConfigError, nearest
from mbcacq.model import yaml12
from mbcacq.model.cell import RobotModel
from mbcacq.model.cell_schema import RobotSpec


def folder() -> Path:
    """The folder with robots/, artefacts/ and the plans. Raises ConfigError if an installation lacks it."""
    package = Path(__file__).resolve().parents[1]
    for place in (package / "_plans", package.parent / "plans"):
        if (place / "robots").is_dir():
            return place
    raise ConfigError("the robots and plans that come with mbcacq are missing; reinstall it")


def plans() -> list[str]:
    """Names of the plans."""
    return sorted(path.stem for path in folder().glob("*.yaml"))


def plan_file(path: Path) -> Path:
    """The path of a plan as it is; where there is no such file, the tool's own plan of that name: ``kuka``, ``kuka.yaml`` and
    ``plans/kuka.yaml`` are all one. A path into any other folder stays what it is."""
    if path.exists() or path.parent.name not in ("", "plans") or len(path.parts) > 2 or path.suffix not in ("", ".yaml"):
        return path
    return folder() / f"{path.stem}.yaml" if path.stem in plans() else path


def plan_name(path: Path) -> str:
    """How a command names a plan: the tool's own by its name alone, any other by its path."""
    return path.stem if path.is_absolute() and path.parent == folder() else str(path)


def robots() -> list[str]:
    """Names of the robots, as ``model:`` of a trajectory set takes them."""
    return sorted(path.stem for path in (folder() / "robots").glob("*.yaml"))


def robot_file(name: str) -> Path:
    """The YAML of a robot by name. Raises ConfigError naming the choices."""
    if name not in robots():
        advice = nearest(name, robots()) or "; correct the name or give its links"
        raise ConfigError(f"there is no robot '{name}' among those of the tool ({', '.join(robots())}){advice}")
    return folder() / "robots" / f"{name}.yaml"


def robot(name: str) -> RobotModel:
    """The arm of that name as it is shipped. Raises ConfigError naming the choices."""
    content = yaml12.load(robot_file(name).read_text(encoding="utf-8"))
    return RobotSpec.model_validate(content).model()


def named_file(kind: str, name: str) -> Path:
    """The file of a robot, artefact or scanner: one of the tool's by its name, or a path. kind: 'robots', 'artefacts' or 'scanners'.

    Raises ConfigError naming the choices.
    """
    own = {path.stem: path for path in sorted((folder() / kind).glob("*.yaml"))}
    if name in own:
        return own[name]
    if Path(name).is_file():
        return Path(name)
    raise ConfigError(
        f"there is no file {name}, and among the tool's {kind} none of that name ({', '.join(own)}){nearest(name, own) or '; correct it'}"
    )
