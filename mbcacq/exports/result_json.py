"""The JSON Schema of result.json, and a reader that names every fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from mbcacq.calibration.result_file import FORMAT, ResultFile
from mbcacq.calibration.result_io import read_result, split_number
from mbcacq.recording.run_folder.latest import refuse_plan


def result_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of result.json."""
    schema = TypeAdapter(ResultFile).json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": FORMAT}


def load_result(path: str | Path) -> dict[str, Any]:
    """The result in a file, or in the run folder's result.json; one of several recordings is given by its number (result.json#2).

    Raises ConfigError naming file and what is wrong."""
    path = Path(path)
    refuse_plan(split_number(path)[0])
    return read_result(path)
