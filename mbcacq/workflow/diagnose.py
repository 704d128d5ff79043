"""Diagnose a recording: poses at standstill, trajectories in time, or a run that has both."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbcacq.calibration import notebook
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.errors import ConfigError
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.workflow.load import as_observations, as_trajectories, is_run_folder, recorded_moves

Data = Observations | Trajectory | Path | str


@dataclass(frozen=True, repr=False)
class DiagnosisResult:
    """What was found. content: format mbcacq-diagnosis/1; text: the same for people. poses, observations: the diagnosis of poses and what
    it is of, None for trajectories. drawn: what pictures are drawn from, where it was computed already. It pickles; JSON keeps the content.
    """

    content: dict[str, Any]
    text: str = ""
    poses: Diagnosis | None = None
    observations: Observations | None = None
    drawn: dict[str, Any] | None = None

    @property
    def verdict(self) -> str:
        """'none', 'explained', 'partly_explained', 'unexplained' or 'cannot_tell'."""
        return self.content["verdict"]

    @property
    def effects(self) -> list[dict[str, Any]]:
        """The effects found, the largest first: name, where, parameters with value and std, p_value, held_out_gain, alternatives."""
        return self.content["effects"]

    def pictures(self) -> dict[str, Any]:
        """What the pictures need, format mbcacq-diagnosis-pictures/1: the evidence map, residuals before and after (mm), curves. Raises
        ConfigError for a diagnosis of trajectories alone, and for one that was read from JSON."""
        from mbcacq.diagnosis.output.figures import pictures

        if self.drawn is not None:
            return self.drawn
        if self.poses is None or self.poses.evidence is None:
            raise ConfigError("pictures are drawn from the diagnosis of poses, as mbcacq.diagnose returns it")
        return pictures(self.poses)

    def write_html(self, path: Path | str) -> Path:
        """The diagnosis as one HTML page that opens offline."""
        from mbcacq.report import write_diagnosis_page

        return write_diagnosis_page(self._of_poses(), self.pictures(), path)

    def write_rrd(self, path: Path | str) -> Path:
        """Arrows before and after in the cell, as a recording for the rerun viewer. Raises ConfigError without observations."""
        from mbcacq.workflow.diagnosis_files import write_rrd

        if self.observations is None:
            raise ConfigError("there are no observations to draw; diagnose the recording anew")
        write_rrd(self.observations, self._words(), self.pictures(), Path(path))
        return Path(path)

    def keep(self, run: Path | str) -> None:
        """Write the diagnosis of the poses into the folder of their run, where report and viewer find it. Raises RecordingError."""
        from mbcacq.workflow.diagnosis_files import keep_in_run

        if self.observations is None:
            raise ConfigError("there are no observations to draw; diagnose the recording anew")
        keep_in_run(self._of_poses(), self._words(), self.pictures(), self.observations, Path(run))

    def to_dict(self) -> dict[str, Any]:
        """The JSON content, format mbcacq-diagnosis/1."""
        return self.content

    def to_json(self) -> str:
        """:meth:`to_dict` as JSON text."""
        return json.dumps(self.content, indent=1, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> DiagnosisResult:
        """The diagnosis of such a text: verdict and effects, without text and pictures. Raises ConfigError where it is none."""
        try:
            content = json.loads(text)
        except ValueError as error:
            raise ConfigError(f"the diagnosis is not JSON ({error}); give what mbcacq diagnose --json writes") from error
        if not isinstance(content, dict) or content.get("format") != "mbcacq-diagnosis/1":
            raise ConfigError("this is no diagnosis of format 'mbcacq-diagnosis/1'; give what mbcacq diagnose --json writes")
        return cls(content)

    def _of_poses(self) -> dict[str, Any]:
        return self.content if self.poses is None else self.poses.as_json()

    def _words(self) -> str:
        from mbcacq.diagnosis.output.text import words

        return self.text if self.poses is None else words(self.poses)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pictures are computed first: what computes them does not pickle."""
        drawn = self.drawn if self.poses is None else self.pictures()
        poses = None if self.poses is None else Diagnosis(**{**vars(self.poses), "evidence": None})
        return DiagnosisResult, (self.content, self.text, poses, self.observations, drawn)

    def __repr__(self) -> str:
        named = ", ".join(f"{e['name']} at {'/'.join(e['where'])}" for e in self.effects)
        return f"DiagnosisResult({self.verdict}{': ' + named if named else ''})"

    def _repr_html_(self) -> str:
        rows = [
            (
                e["name"],
                ", ".join(e["where"]),
                ", ".join(f"{name} {p['value']:.4g}" for name, p in e["parameters"].items() if isinstance(p["value"], int | float)),
                f"{e['p_value']:.2g}",
                f"{100 * e['held_out_gain']:.0f} %",
            )
            for e in self.effects
        ]
        header = ("effect", "where", "parameters", "p-value", "held-out gain")
        return notebook.table(f"Diagnosis: {self.verdict}", header, rows)


def diagnose(
    data: Data | Sequence[Data], *, progress: Callable[[str], None] = lambda text: None, workers: int | None = None
) -> DiagnosisResult:
    """Find the effects that the model of the cell lacks, and say how sure that is.

    data: observations, or a run folder, a recording, an observation set; or trajectories of one robot (objects or trajectory sets), one or
    several together. Of a run whose controller recorded torques or joint-side angles, the motion between the poses is compared too.
    progress: gets a sentence a step. workers: processes that share the cross-validation (default: one a processor core).

    Raises ConfigError for data that do not belong together, CalibrationError where they do not determine the geometry.
    """
    several = list(data) if isinstance(data, Sequence) and not isinstance(data, str) else [data]
    if all(_is_trajectory(one) for one in several):
        return diagnose_motion([one for one in several if not isinstance(one, Observations)])
    if len(several) > 1:
        raise ConfigError("several DATA can be diagnosed together only if all are trajectory sets; diagnose the others one by one")
    (one,) = several
    if isinstance(one, Trajectory):
        raise TypeError("a trajectory is diagnosed as motion")
    found = diagnose_poses(as_observations(one), progress, workers)
    return found if isinstance(one, Observations) else combined_with_motion(found, Path(one), progress)


def diagnose_motion(trajectories: Sequence[Trajectory | Path | str]) -> DiagnosisResult:
    """The diagnosis of trajectories of one robot, together. Raises ConfigError where they do not fit together."""
    from mbcacq.diagnosis.motion import diagnose_trajectories
    from mbcacq.diagnosis.motion.text import trajectory_words

    content = diagnose_trajectories(as_trajectories(trajectories))
    return DiagnosisResult(content, trajectory_words(content))


def diagnose_poses(observations: Observations, progress: Callable[[str], None], workers: int | None) -> DiagnosisResult:
    """The diagnosis of poses at standstill. Raises CalibrationError."""
    from mbcacq.diagnosis import diagnose as room
    from mbcacq.diagnosis.output.text import words
    from mbcacq.diagnosis.validation.workers import cores

    found = room.diagnose(observations, progress=progress, workers=workers or cores())
    return DiagnosisResult(found.as_json(), words(found), found, observations)


def combined_with_motion(found: DiagnosisResult, recording: Path, progress: Callable[[str], None]) -> DiagnosisResult:
    """The diagnosis of the poses combined with that of the motion between them, where a run recorded torques or joint-side angles."""
    from mbcacq.diagnosis.motion import combine, diagnose_trajectories

    if not (is_run_folder(recording) or recording.suffix == ".rrd"):
        return found
    try:
        stretches = recorded_moves(recording)
    except ConfigError:
        return found
    if not stretches:
        return found
    progress("comparing the motion between the poses")
    content = combine.joined(found.content, diagnose_trajectories(stretches))
    return DiagnosisResult(content, combine.words(content, found.text), found.poses, found.observations)


def _is_trajectory(data: Data) -> bool:
    from mbcacq.recording.datasets.trajectory_set import is_trajectory_set

    return isinstance(data, Trajectory) or (isinstance(data, Path | str) and is_trajectory_set(data))
