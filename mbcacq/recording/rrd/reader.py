"""Reader of recordings: observations bit for bit as the run used them, raw cycles, scans, plan and cell texts."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from mbcacq.devices import Cycles, Scan
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.model.observations import Observations
from mbcacq.recording.rrd import layout, packed_cloud, packed_cycles
from mbcacq.recording.rrd.assemble import assemble
from mbcacq.recording.rrd.checksums import digest_of_values, is_as_written, read_stretches
from mbcacq.recording.rrd.library_reader import LibraryReader
from mbcacq.recording.rrd.process_reader import ProcessReader
from mbcacq.recording.rrd.rerun_path import rerun_path
from mbcacq.recording.rrd.sweeps import sweep_observations

Row = dict[str, Any]
_OPEN: ContextVar[dict[tuple[str, int, int], Recording] | None] = ContextVar("_OPEN", default=None)
COPIES = {layout.CELL: (layout.CELL_COPY,)}


@dataclass(frozen=True)
class RecordedScan:
    """A scan and where it was taken: number of the pose in the plan and of the exposure at that pose."""

    pose: int
    exposure: int
    scan: Scan


class Recording:
    """One .rrd file. Every method reads only what it is asked for.

    A file that is not known to be as it was written is read in a process of its own: the rerun library ends its process at some of them.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise ConfigError(f"{self.path} does not exist; give a recording (.rrd)")
        if self.path.stat().st_size == 0:
            raise RecordingError(f"{self.path} is empty: nothing was ever written into it; give another recording")
        rerun_path(self.path)
        self._reader = LibraryReader(self.path) if is_as_written(self.path) else ProcessReader(self.path)

    @property
    def recording_id(self) -> str:
        return self._reader.recording_id

    def rows(self, entity: str) -> Iterator[Row]:
        """Rows of one entity in the order they were logged: component name -> array or list, timeline -> int (ns, or number)."""
        return _rows(self._batches(entity))

    def columns(self, entity: str, archetype: str, only: Collection[str] = ()) -> dict[str, np.ndarray]:
        """All rows of an entity whose rows have equal lengths: component -> (k,) or (k, n), in the order they were logged.

        only: names of the components to be read, () for all.
        """
        return _joined(_tables(batch, archetype, only) for batch in self._batches(entity))

    def scalars(self, entities: str) -> dict[str, list[float]]:
        """All curves below an entity ('health/**'): entity path -> values in the order they were logged."""
        found: dict[str, list[float]] = {}
        for batch in self._batches(entities):
            path = (batch.schema.metadata or {}).get(b"rerun:entity_path", b"").decode()
            for i in range(batch.num_columns):
                if _short_name(batch.schema.field(i)) == "scalars":
                    found.setdefault(path, []).extend(batch.column(i).flatten().to_pylist())
        return found

    def text(self, entity: str) -> str:
        """A document: the plan or the cell. Raises RecordingError if the recording was cut before it, or if it is damaged."""
        damaged = False
        for copy in (entity, *COPIES.get(entity, ())):
            for row in self.rows(copy):
                if "text" in row:
                    if intact({"text": row["text"], **({layout.DIGEST: row[layout.DIGEST]} if layout.DIGEST in row else {})}):
                        return row["text"][0]
                    damaged = True
        if damaged:
            raise RecordingError(f"{self.path}: its {entity} is damaged, bits changed since it was written; see mbcacq recover --check")
        raise RecordingError(f"{self.path}: the recording ends before its {entity}; nothing in it can be calibrated")

    def about(self) -> Row:
        """Name, start, number of planned poses, versions, exit status... as far as they were written."""
        merged: Row = {}
        for row in self.rows(layout.RUN):
            merged |= {name: value[0] if len(value) == 1 else value for name, value in row.items() if not isinstance(value, int)}
        return merged

    def cycles(self, only: Collection[str] = ()) -> Cycles:
        """Every controller cycle, as the driver delivered it; without batches whose bytes are damaged.

        only: names of the columns to be read, () for all.
        """
        return Cycles(_joined(tables for batch in self._batches(layout.CYCLES) for tables in _cycle_tables(batch, only)))

    def scans(self) -> Iterator[RecordedScan]:
        """Every scan in the order taken, one at a time."""
        for row in _rows(self._reader.stream(layout.SCAN)):
            if ("positions" in row or "packed_points" in row) and "exposure_us" in row:
                scan = Scan(
                    points=row.get("positions", np.zeros(0, np.float32)).reshape(-1, 3),
                    intensity=row.get("intensity"),
                    shape=tuple(row["shape"].tolist()),
                    pixel=row.get("pixel"),
                    time_s=float(row["time_s"][0]),
                    frame=int(row["frame"][0]),
                    exposure_us=float(row["exposure_us"][0]),
                    measurements=_mapping(row, "measurements"),
                )
                yield RecordedScan(int(row["pose"][0]), int(row["exposure"][0]), self._unpacked(scan, row))

    def _unpacked(self, scan: Scan, row: Row) -> Scan:
        if "packed_points" not in row:
            return scan
        try:
            return packed_cloud.unpacked(scan, row)
        except ValueError as error:
            raise RecordingError(f"{self.path}: the scan of pose {int(row['pose'][0])}: {error}; see mbcacq recover --check") from error

    def observed(self) -> list[Row]:
        """The pose observations that are as they were written, in the order made."""
        return [row for row in self.rows(layout.OBSERVATION) if "q" in row and intact(row)]

    def damaged_poses(self) -> list[int]:
        """Numbers of the pose observations that are not as they were written, and so not among the observed."""
        return [
            int(row["pose"][0]) for row in self.rows(layout.OBSERVATION) if len(row.get("pose", ())) and not ("q" in row and intact(row))
        ]

    def damaged_cycles(self) -> int:
        """The number of batches of controller cycles that are not as they were written, and so not among ``cycles``."""
        packed = [batch for batch in self._batches(layout.CYCLES) if _is_packed(batch)]
        return sum(batch.num_rows - len(list(_cycle_tables(batch, ("time_s",)))) for batch in packed)

    def _batches(self, entity: str) -> list[pa.RecordBatch]:
        """In the order of logging, whatever order a merge left the chunks in: row ids count up with time."""
        batches = [batch for batch in self._reader.stream(entity) if batch.num_rows]
        return sorted(batches, key=lambda batch: batch.column(0)[0].as_py())


def open_recordings(path: Path | str) -> list[Recording]:
    """The recordings of a run folder in order (several where it was resumed), or the one file.

    Raises RecordingError where fewer bytes are left than were written: the library reads a file cut between two messages without a word.
    """
    path = Path(path)
    files = layout.parts(path) if path.is_dir() else [path]
    if not files:
        raise ConfigError(f"{path} holds no recording (run.rrd); give the folder of a run")
    for file in files:
        written = max((stretch.end for stretch in read_stretches(file.parent)[0].get(file.name, [])), default=0)
        if file.is_file() and 0 < file.stat().st_size < written:
            raise RecordingError(
                f"{file} is torn ({written} bytes were written, {file.stat().st_size} are left); copy it once more, "
                f"or make what is left of it readable: mbcacq recover {file}"
            )
    return [opened(file) for file in files]


@contextmanager
def opened_once() -> Iterator[None]:
    """Inside, a file that has not changed is opened once, whoever asks for it: opening reads its whole index."""
    known = _OPEN.get()
    token = _OPEN.set({} if known is None else known)
    try:
        yield
    finally:
        _OPEN.reset(token)


def opened(file: Path) -> Recording:
    """One .rrd file; the same object again inside ``opened_once``."""
    known = _OPEN.get()
    if known is None or not file.is_file():
        return Recording(file)
    state = file.stat()
    key = (str(file.absolute()), state.st_mtime_ns, state.st_size)
    if key not in known:
        known[key] = Recording(file)
    return known[key]


def read_observations(path: Path | str) -> Observations:
    """The observations of a run. A pose measured again after a resume counts as measured last.

    time_s is the controller's clock of the first part; a later part, whose controller may have been restarted, is set after
    it by the computer's clock. Raises RecordingError if the recording is torn or holds no observation.
    """
    recordings = open_recordings(path)
    rows = [row for recording in recordings for row in recording.observed()]
    if not rows:
        raise RecordingError(f"{path} holds no finished pose; there is nothing to calibrate")
    measured = assemble(recordings[0].text(layout.CELL), str(path), rows)
    sweeps = [row for recording in recordings for row in recording.rows(layout.SWEEP) if "points" in row and intact(row)]
    if not sweeps:
        return measured

    return sweep_observations(measured, sweeps, [recording.cycles(("time_s", "q")) for recording in recordings], str(path))


def intact(row: Row) -> bool:
    """Whether the values of a row are those that its digest was made of; a row of an earlier version has none."""
    values = {name: value for name, value in row.items() if isinstance(value, np.ndarray | list)}
    digest = values.pop(layout.DIGEST, None)
    return digest is None or digest == [digest_of_values(values)]


def _rows(batches: Iterable[pa.RecordBatch]) -> Iterator[Row]:
    for batch in batches:
        names = {i: _short_name(batch.schema.field(i)) for i in range(batch.num_columns)}
        for k in range(batch.num_rows):
            yield {name: value for i, name in names.items() if (value := _cell(batch.column(i), k)) is not None}


def _tables(batch: pa.RecordBatch, archetype: str, only: Collection[str] = ()) -> dict[str, np.ndarray]:
    """The columns of an archetype as (k, n) each, for rows of equal lengths."""
    out = {}
    for i in range(batch.num_columns):
        field = batch.schema.field(i)
        if (field.metadata or {}).get(b"rerun:archetype", b"").decode() == archetype and (not only or _short_name(field) in only):
            flat = batch.column(i).flatten().to_numpy(zero_copy_only=False)
            out[_short_name(field)] = flat.reshape(batch.num_rows, -1)
    return out


def _cycle_tables(batch: pa.RecordBatch, only: Collection[str]) -> Iterator[dict[str, np.ndarray]]:
    """Those of each row of packed cycles, or the cycles of an earlier version, whose columns were components."""
    if not _is_packed(batch):
        yield _tables(batch, layout.CYCLES_ARCHETYPE, only)
        return
    for row in _rows([batch]):
        with suppress(ValueError):  # a bit changed: damaged_cycles counts these
            yield packed_cycles.unpacked(row[layout.PACKED], only)


def _is_packed(batch: pa.RecordBatch) -> bool:
    return any(_short_name(field) == layout.PACKED for field in batch.schema)


def _joined(tables: Iterable[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """(k, n) each, one after the other, as (k,) where n is 1."""
    found: dict[str, list[np.ndarray]] = {}
    for table in tables:
        for name, values in table.items():
            found.setdefault(name, []).append(values)
    joined = {name: np.concatenate(parts) for name, parts in found.items()}
    return {name: values[:, 0] if values.shape[1] == 1 else values for name, values in joined.items()}


def _cell(column: pa.Array, row: int) -> Any:
    value = column[row]
    if not value.is_valid:
        return None
    if isinstance(value, pa.ListScalar):
        inner = value.values
        if pa.types.is_string(inner.type):
            return inner.to_pylist()
        while isinstance(inner, (pa.FixedSizeListArray, pa.ListArray)):
            inner = inner.flatten()
        return inner.to_numpy(zero_copy_only=False) if pa.types.is_primitive(inner.type) else inner.to_pylist()
    if isinstance(value, (pa.DurationScalar, pa.TimestampScalar)):
        return value.value
    return value.as_py()


def _short_name(field: pa.Field) -> str:
    return field.name.rsplit(":", 1)[-1]


def _mapping(row: Row, prefix: str) -> dict[str, float]:
    values = row.get(f"{prefix}_values", ())
    return dict(zip(row.get(f"{prefix}_names", ()), (float(v) for v in values), strict=False))
