"""Options of ``mbcacq export`` that concern results and certificates."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

_OPTIONS = (
    click.option(
        "--results",
        type=click.Path(path_type=Path, file_okay=False),
        help="Write the calibration of RUN (a folder with result.json, or that file) into this folder: JSON, CSV, KUKA, ROS.",
    ),
    click.option("--tool", type=click.IntRange(1, 128), default=1, show_default=True, help="With --results: number of TOOL_DATA."),
    click.option("--tool-name", default="mbcacq scanner", show_default=True, help="With --results: TOOL_NAME."),
    click.option("--config-dat", type=click.Path(path_type=Path), help="With --results: a $config.dat to write a unified diff against."),
    click.option("--urdf", type=click.Path(path_type=Path), help="With --results: a URDF or xacro to write a calibrated copy of."),
    click.option("--joint", "joints", multiple=True, help="With --urdf: its moving joints, base first (default: all revolute ones)."),
    click.option("--flange-frame", default="tool0", show_default=True, help="With --results: name of the flange in ROS."),
    click.option("--scanner-frame", default="scanner_frame", show_default=True, help="With --results: name of the scanner in ROS."),
    click.option(
        "--artefact",
        metavar="ID",
        help="RUN is a certificate (CSV, YAML, DMIS output): write it as the artefact file ID.yaml here, or where --output says.",
    ),
    click.option("--output", type=click.Path(path_type=Path, dir_okay=False), help="With --artefact: the file to write."),
)


def result_options(command: Callable) -> Callable:
    """Add the options to a click command, which passes them on to ``export_results`` as keyword arguments."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command
