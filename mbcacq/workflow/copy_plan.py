"""One of the tool's plans, with the files that it names, in a folder of the user's."""

from __future__ import annotations

from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import finish_set, write_files
from mbcacq.model import shipped
from mbcacq.model.yaml_source import parse
from mbcacq.plan import LoadedPlan, load


def copy_plan(name: str, folder: Path | str = ".", *, force: bool = False) -> list[Path]:
    """Copy a plan that came with the tool; its files, the plan first. An interruption replaces none of them or all.

    Parameters
    ----------
    name
        Name of the plan: 'kuka', 'kuka.yaml' or 'plans/kuka.yaml'.
    folder
        Made where it is missing. Robot and artefact files keep their places relative to the plan, so that the copy loads as it stands.
    force
        Replace files that exist and differ; one that is the same already is left alone.

    Raises
    ------
    ConfigError
        Where there is no such plan, or a file exists with other content.
    RecordingError
        Where a file cannot be written.
    """
    own = shipped.folder() / f"{Path(name).stem}.yaml"
    if Path(name).stem not in shipped.plans():
        raise ConfigError(f"there is no plan '{name}' among those of the tool ({', '.join(shipped.plans())}); name one of these")
    loaded = load(own)
    plan = loaded.plan
    named = [own.name, plan.robot.model, *plan.artefacts, *_meshes(loaded), *([plan.robot.urdf] if plan.robot.urdf else [])]
    folder = Path(folder)
    finish_set(folder)
    content = {one: (own.parent / one).read_bytes() for one in named}
    changed = {one: data for one, data in content.items() if not (folder / one).is_file() or (folder / one).read_bytes() != data}
    if not force and (there := next((folder / one for one in changed if (folder / one).exists()), None)):
        raise ConfigError(f"{there} exists and differs from the tool's; give another folder, or --force to replace it")
    write_files(folder, changed)
    return [folder / one for one in content]


def _meshes(loaded: LoadedPlan) -> list[str]:
    """The meshes that its parts name, relative to the plan."""
    meshes = [(name, parse(text, Path(name)).data.get("mesh")) for name, text in loaded.files.items()]
    return [str(Path(name).parent / mesh) for name, mesh in meshes if mesh]
