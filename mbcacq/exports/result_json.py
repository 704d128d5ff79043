"""The JSON Schema of result.json, and a reader that names every fault."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mbcacq.calibration.joint_file import result_of_one, split_number
from mbcacq.calibration.result_schema import ResultFile, check_result
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import finish_set
from mbcacq.model.json_text import read_json
from mbcacq.recording.run_folder.latest import refuse_plan

MAX_BYTES = 256 << 20


def result_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of result.json."""
    schema = ResultFile.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "mbcacq-result/1"}


def load_result(path: str | Path) -> dict[str, Any]:
    """The result in a file, or in the run folder's result.json; of one of several recordings by its number (result.json#2).

    Raises ConfigError naming file and what is wrong."""
    path, number = split_number(Path(path))
    refuse_plan(path)
    if path.is_dir():
        finish_set(path)
    file = path / "result.json" if path.is_dir() else path
    try:
        if file.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{file}: larger than {MAX_BYTES >> 20} MiB; this is no calibration result")
        text = file.read_bytes()
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}; give a result.json, or the run folder that holds one") from error
    data = read_json(text, f"{file}", "give the result.json that mbcacq calibrate writes")
    data = result_of_one(data, number, file)
    if not isinstance(data, dict) or data.get("format") != "mbcacq-result/1":
        raise ConfigError(f"{file}: is not a calibration result of format 'mbcacq-result/1'; give the one that mbcacq calibrate writes")
    check_result(data, str(file))
    return data
