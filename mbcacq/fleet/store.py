"""The folder of a fleet: one file for each recording, written as results come, and the table of all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbcacq.calibration.sealed_json import sealed_text, unsealed
from mbcacq.errors import ConfigError
from mbcacq.fleet.evaluation import EVALUATED, FAILED, FORMAT, FleetTask
from mbcacq.fleet.recordings import FleetRecording
from mbcacq.geometry.chain import PARAMETERS

LARGEST = 1e100  # of a figure of a table: its square is a number too
TABLE, PAGE, RECORDINGS = "fleet.parquet", "fleet.html", "recordings"
TEXTS = ("recording", "arm", "time", "robot", "status", "reason", "verdict")
COUNTS = ("poses", "centres", "rejected")
LISTS = {"effects": "string", "out_of_control": "string", "names": "string", "nominal": "double", "covariance": "double"}
NUMBERS = (
    "wall_s", "processor_s", "rms_mm", "chi2_dof", "expected_accuracy_mm", "spacing_max_mm", "spacing_mean_mm", "scanner_noise_mm",
    "joint_noise_rad", "transfer_rms_mm", "transfer_own_rms_mm", "transfer_normalised_error",
)  # fmt: skip


@dataclass(frozen=True)
class StoredResult:
    """What came of a recording. row: of the table; text: of its file, UTF-8, empty where the file is written."""

    row: dict[str, Any]
    text: bytes


def stored_result(content: Mapping[str, Any], stamp: str) -> StoredResult:
    """content: as ``evaluate_recording`` gives it. stamp: of the recording before it was read."""
    return StoredResult(content["row"], sealed_text({**content, "stamp": stamp}).encode())


class FleetStore:
    """Results in a folder. A result counts while recording, task and version of the program are what they were, and its checksum holds.

    damaged: files of results whose content is damaged, which do not count.
    """

    def __init__(self, folder: Path, task: FleetTask):
        from mbcacq.version import __version__

        tried = Path(task.verify).read_bytes() if task.verify and Path(task.verify).is_file() else b""
        self.damaged: list[Path] = []
        self.folder, self.task = folder, hashlib.sha256(f"{__version__}|{task!r}|".encode() + tried).hexdigest()
        try:
            (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{folder} cannot be made ({error.strerror}); give another --out") from error

    def path(self, recording: FleetRecording) -> Path:
        return self.folder / RECORDINGS / f"{recording.key}.json"

    def stamp(self, recording: FleetRecording) -> str:
        """What a result is valid for."""
        return hashlib.sha256(f"{self.task}|{recording.fingerprint()}".encode()).hexdigest()

    def row(self, recording: FleetRecording) -> dict[str, Any] | None:
        """The row of a recording that is done; None where it is not, is damaged, has changed since, or failed for no fault of its own."""
        path = self.path(recording)
        try:
            content = unsealed(json.loads(path.read_bytes()), path)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError):  # ConfigError of a checksum is a ValueError
            if path not in self.damaged:
                self.damaged.append(path)
            return None
        if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("stamp") != self.stamp(recording):
            return None
        row = content["row"] | {"arm": recording.arm, "time": recording.time or None}
        return None if row["status"] == FAILED else row

    def keep(self, recording: FleetRecording, outcome: StoredResult) -> dict[str, Any]:
        """Write a result, in one step; its row. Raises RecordingError."""
        from mbcacq.files.atomic_write import write_file

        write_file(self.path(recording), outcome.text)
        return outcome.row

    def write(self, rows: Sequence[Mapping[str, Any]], page: str) -> tuple[Path, Path]:
        """All rows as one Parquet table, in the order given, and the page about them (HTML), as a set. Raises RecordingError."""
        from mbcacq.files.atomic_write import write_files

        def table(partial: Path) -> None:
            from pyarrow import parquet

            parquet.write_table(as_table(rows), partial)

        written = write_files(self.folder, {TABLE: table, PAGE: page})
        return written[0], written[1]


def as_table(rows: Sequence[Mapping[str, Any]]) -> Any:
    """Rows as a table of Arrow, of the same columns whatever the recordings have."""
    import pyarrow as pa

    parameters = dict.fromkeys(name for row in rows for name in row if name.startswith(("error.", "std.")))
    types = {name: pa.string() for name in TEXTS} | {name: pa.int64() for name in COUNTS}
    types |= {"simulated": pa.bool_()} | {name: pa.float64() for name in (*NUMBERS, *parameters)}
    types |= {name: pa.list_(pa.string() if kind == "string" else pa.float64()) for name, kind in LISTS.items()}
    return pa.Table.from_pylist([dict(row) for row in rows], schema=pa.schema(list(types.items())))


def read_table(fleet: Path) -> list[dict[str, Any]]:
    """The rows of a fleet: of its folder, or of its Parquet table. Raises ConfigError."""
    from pyarrow import parquet
    from pyarrow.lib import ArrowException

    path = fleet / TABLE if fleet.is_dir() else fleet
    try:
        rows = parquet.read_table(path).to_pylist()
    except (OSError, ArrowException, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read as the table of a fleet ({error}); give what mbcacq fleet wrote") from error
    needed = {"recording", "arm", "robot", "time", "status", "names", "covariance", "nominal"}
    if not rows or not needed <= set(rows[0]):
        raise ConfigError(f"{path} is no table of a fleet; give what mbcacq fleet wrote")
    for number, row in enumerate(rows, 1):
        if row["status"] == EVALUATED and not is_evaluated(row):
            raise ConfigError(f"{path}: row {number} is damaged; evaluate the fleet anew")
    return rows


def is_evaluated(row: Mapping[str, Any]) -> bool:
    """Whether a row has the figures of a calibrated arm, each of its kind: errors of its parameters, their covariance, the nominal arm."""
    names, figures = row["names"], [row[name] for name in row if name.startswith(("error.", "std."))]
    lists = [names, row["covariance"], row["nominal"]]
    return (
        all(isinstance(row.get(name), str) for name in ("recording", "arm", "robot"))
        and isinstance(row.get("time"), str | None)
        and all(isinstance(values, list) for values in lists)
        and all(isinstance(name, str) for name in names)
        and all(_is_figure(row.get(f"error.{name}")) for name in names if name.rpartition("_")[0] in PARAMETERS)
        and all(
            _is_figure(row.get(name.replace("error.", "std.", 1))) for name in row if name.startswith("error.") and row[name] is not None
        )
        and len(row["covariance"]) == len(names) ** 2
        and len(row["nominal"]) % len(PARAMETERS) == 0
        and all(map(_is_figure, (*row["covariance"], *row["nominal"])))
        and all(figure is None or _is_figure(figure) for figure in figures)
        and all(row.get(name) is None or isinstance(row[name], int | float) for name in NUMBERS)
    )


def _is_figure(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= LARGEST
