"""Compiles the one loop that is in C, where there is a compiler. Without it the package works as well, with numpy in its place."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "drivers/mbcacq_gocator"


class CompiledLoop(BuildHookInterface[Any]):
    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        package = Path(self.root) / PACKAGE
        library = runpy.run_path(str(package / "build_loop.py"))["build"](package / "surface_loop.c", package)
        if library is not None:
            build_data["force_include"][str(library)] = f"{package.name}/{library.name}"
            build_data["pure_python"], build_data["infer_tag"] = False, True
