"""One of the tool's plans, with the files that it names, in a folder of the user's."""

from __future__ import annotations

from pathlib import Path

from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_file
from mbcacq.model import shipped
from mbcacq.plan import load


def copy_plan(name: str, folder: Path | str = ".", *, force: bool = False) -> list[Path]:
    """Copy a plan that came with the tool; the files written, the plan first.

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
    plan = load(own).plan
    named = [own.name, plan.robot.model, *plan.artefacts, *([plan.robot.urdf] if plan.robot.urdf else [])]
    content = {Path(folder) / one: (own.parent / one).read_bytes() for one in named}
    for path, data in content.items():
        if not force and path.exists() and (not path.is_file() or path.read_bytes() != data):
            raise ConfigError(f"{path} exists and differs from the tool's; give another folder, or --force to replace it")
    for path, data in content.items():
        write_file(path, data)
    return list(content)
