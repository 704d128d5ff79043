"""Files that go onto a robot's controller, made from a plan by the robot's driver."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mbcacq.acquisition.cell_devices import robot_options
from mbcacq.devices import load_driver
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_files
from mbcacq.geometry import se3
from mbcacq.plan import LoadedPlan
from mbcacq.quantities import in_degrees


def make(loaded: LoadedPlan) -> dict[str, str]:
    """Relative path -> text, from the driver's static method ``controller_files(name, model, options, facts)``. Raises ConfigError."""
    use = loaded.plan.robot
    maker = getattr(load_driver("robots", use.driver), "controller_files", None)
    if maker is None:
        raise ConfigError(f"driver '{use.driver}' needs no files on the controller, or brings none along; see its own documentation")
    made = maker(use.driver, loaded.cell.robot.name, robot_options(loaded), facts(loaded))
    return {name: text.replace("\r\n", "\n").replace("\n", "\r\n") for name, text in made.items()}  # a controller's line ends


def facts(loaded: LoadedPlan) -> dict[str, Any]:
    """What of a plan belongs onto a controller: plan, robot, speed_share, tool_frame X Y Z A B C (mm, deg; first guess of the scanner on
    the flange), load_kg, load_centre_mm, home_deg."""
    robot = loaded.cell.robot
    xyz, abc = se3.to_abc(loaded.cell.T_flange_scanner)
    return {
        "plan": loaded.plan.name,
        "robot": robot.name,
        "speed_share": loaded.plan.robot.speed,
        "tool_frame": (*xyz.tolist(), *in_degrees(abc).tolist()),
        "load_kg": robot.payload_mass,
        "load_centre_mm": tuple(robot.payload_com.tolist()),
        "home_deg": tuple(loaded.plan.robot.home_deg),
    }


def write(files: dict[str, str], out: Path, replace: bool = False) -> list[Path]:
    """Write text files for a controller below ``out``, in ASCII with their line ends. Raises ConfigError where one exists already,
    RecordingError."""
    if not replace and (there := [out / name for name in files if (out / name).exists()]):
        raise ConfigError(f"{there[0]} exists already; give another --out, or --replace")
    return write_files(out, {name: text.encode("ascii", "replace") for name, text in files.items()})
