"""What building the package adds: the one loop that is in C, where there is a compiler (without it numpy does the same), and plotly.js."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface  # pyright: ignore[reportMissingImports] -- of the build alone

LOOP_PACKAGE = "drivers/mbcacq_gocator"
DRAWING_LIBRARY = "mbcacq/figure/plotly.min.js"


class Built(BuildHookInterface[Any]):
    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        from plotly.offline import get_plotlyjs  # Plotly for Python is needed for building alone

        (Path(self.root) / DRAWING_LIBRARY).write_text(get_plotlyjs(), encoding="utf-8")
        build_data["artifacts"].append(DRAWING_LIBRARY)
        package = Path(self.root) / LOOP_PACKAGE
        library = runpy.run_path(str(package / "build_loop.py"))["build"](package / "surface_loop.c", package)
        if library is not None:
            build_data["force_include"][str(library)] = f"{package.name}/{library.name}"
            build_data["pure_python"], build_data["infer_tag"] = False, True
