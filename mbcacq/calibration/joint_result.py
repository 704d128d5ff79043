"""The result of several recordings of one arm, format 'mbcacq-joint-result/1': one result.json of format 'mbcacq-result/1' for each
recording, all with the same arm and effects.

One of them is named by its number behind the file: ``result.json#2`` is the cell of the second recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from mbcacq.calibration.joint_file import FORMAT
from mbcacq.calibration.result import Calibration


@dataclass(frozen=True)
class JointCalibration(Sequence[Calibration]):
    """One calibration for each recording, in their order; arm and effects are the same in all. names: of the recordings."""

    recordings: tuple[Calibration, ...]
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.recordings)

    def __getitem__(self, index: Any) -> Any:
        return self.recordings[index]

    def __iter__(self) -> Iterator[Calibration]:
        return iter(self.recordings)

    def to_dict(self) -> dict[str, Any]:
        """JSON content. 'day_to_day': for each coefficient of the effects on the arm its values in the recordings, what they have in common
        and the standard deviation between them; it stands once, not in each recording's result."""
        results = [one.to_dict() for one in self.recordings]
        day_to_day = [one.pop("day_to_day", []) for one in results][0]
        recordings = [{"name": name, "result": one} for name, one in zip(self.names, results, strict=True)]
        return {"format": FORMAT, "recordings": recordings, "day_to_day": day_to_day}
