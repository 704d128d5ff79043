"""Diagnose a recording: poses at standstill, trajectories in time, or a run that has both."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mbcacq.calibration.transfer import Transfer, check_transfer
from mbcacq.diagnosis.motion.result import MotionDiagnosis, MotionEffect, UnmodelledMotionEffect
from mbcacq.diagnosis.result import FORMAT, READABLE, Diagnosis, EffectFound
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.workflow.load import as_observations, as_trajectories, is_run_folder, recorded_moves

Data = Observations | Trajectory | Path | str


@dataclass(frozen=True, repr=False)
class DiagnosisResult:
    """What was found. poses: the diagnosis of the poses at standstill; motion: that of the motion; at least one of them is there.

    observations: what the diagnosis of the poses is of, None for one that was read from JSON. checks: what was learnt, tried on other
    recordings. provenance: the files (name, bytes, SHA-256), the versions of the programs, the options. It pickles, with its pictures.
    """

    poses: Diagnosis | None = None
    motion: MotionDiagnosis | None = None
    observations: Observations | None = None
    checks: tuple[Transfer, ...] = ()
    provenance: Mapping[str, Any] | None = None

    @property
    def main(self) -> Diagnosis | MotionDiagnosis:
        """The diagnosis whose verdict counts: that of the poses, where there is one."""
        found = self.poses or self.motion
        if found is None:
            raise ConfigError("this diagnosis is of nothing; diagnose a recording with mbcacq.diagnose")
        return found

    @property
    def model(self) -> EffectModel | None:
        """The effects found in the poses as terms that :func:`mbcacq.calibrate` takes; None where there are none."""
        return self.poses.model if self.poses is not None else None

    @property
    def verdict(self) -> str:
        """'none', 'explained', 'partly_explained', 'unexplained' or 'cannot_tell'."""
        return self.main.verdict

    @property
    def effects(self) -> Sequence[EffectFound | MotionEffect | UnmodelledMotionEffect]:
        """The effects found, the largest first: name, where, parameters (value and std by name), p_value, held_out_gain, alternatives."""
        return self.main.effects

    @property
    def text(self) -> str:
        """The diagnosis in plain sentences, as the command line prints it."""
        from mbcacq.diagnosis.motion.combine import combined_text
        from mbcacq.diagnosis.motion.text import motion_text
        from mbcacq.diagnosis.output.text import words

        if self.poses is None:
            return motion_text(self.motion) if self.motion else ""
        text = words(self.poses) if self.motion is None else combined_text(self.poses.to_json(), words(self.poses), self.motion)
        return "\n".join([text, *(check.text for check in self.checks)])

    def pictures(self) -> dict[str, Any]:
        """What the pictures need, format mbcacq-diagnosis-pictures/1: the evidence map, residuals before and after (mm), curves. Raises
        ConfigError for a diagnosis of trajectories alone, and for one that was read from JSON."""
        from mbcacq.diagnosis.output.figures import pictures

        if self.poses is None or self.poses.plot_data is None:
            raise ConfigError("pictures are drawn from the diagnosis of poses, as mbcacq.diagnose returns it")
        return pictures(self.poses)

    def write_html(self, path: Path | str) -> Path:
        """The diagnosis as one HTML page that opens offline."""
        from mbcacq.report import write_diagnosis_page

        return write_diagnosis_page(self.main.to_json(), self.pictures(), path, about=self._about())

    def _about(self) -> list[tuple[str, str]]:
        """Robot, data and date, as the page names them."""
        from datetime import datetime

        from mbcacq.version import __version__

        data = str((self.provenance or {}).get("recording") or "")
        out = [] if self.observations is None else [("robot", self.observations.cell.robot.name)]
        if self.observations is not None:
            out.append(("poses", f"{self.observations.n_poses}, with {self.observations.n_centres} centres"))
        out += [("data", data)] if data else []
        return [*out, ("diagnosed", f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"), ("software", f"mbcacq {__version__}")]

    def write_rrd(self, path: Path | str) -> Path:
        """Arrows before and after in the cell, as a recording for the rerun viewer. Raises ConfigError without observations."""
        from mbcacq.workflow.diagnosis_files import cards_of, write_rrd

        observations, drawn = self._drawable()
        write_rrd(observations, self._words_of_poses(), drawn, Path(path), cards_of(self.main.to_json()))
        return Path(path)

    def keep(self, run: Path | str) -> None:
        """Write the diagnosis of the poses into the folder of their run, where report and viewer find it. Raises RecordingError."""
        from mbcacq.workflow.diagnosis_files import keep_in_run

        observations, drawn = self._drawable()
        keep_in_run(self.main.to_json(), self._words_of_poses(), drawn, observations, Path(run))

    def to_dict(self) -> dict[str, Any]:
        """The JSON content, format mbcacq-diagnosis/2 (see :func:`mbcacq.diagnosis.schema.diagnosis_schema`); where there are both, the
        motion stands under its own key. Trajectories alone give version 1."""
        from mbcacq.diagnosis.motion.combine import combined
        from mbcacq.diagnosis.result import plain

        content = self.main.to_json()
        if self.poses is None:
            return content
        content |= {
            "recordings": self._recordings(),
            "checks": [plain(check.to_dict()) for check in self.checks],
            "provenance": plain(dict(self.provenance or {})),
        }
        return content if self.motion is None else combined(content, self.motion)

    def _recordings(self) -> list[dict[str, Any]]:
        """Before and after in each recording: the one learnt from, and those that it was tried on."""
        from mbcacq.diagnosis.result import plain

        assert self.poses is not None, "a diagnosis of poses has recordings"
        fit = self.poses.fit
        files = (self.provenance or {}).get("recording") or ""
        learnt = {
            "name": str(files),
            "role": "learnt",
            "before_rms_mm": fit.train.before_rms_mm,
            "after_rms_mm": fit.train.after_rms_mm,
            "held_out_before_rms_mm": fit.held_out.before_rms_mm,
            "held_out_after_rms_mm": fit.held_out.after_rms_mm,
        }
        tried = [
            {
                "name": check.recording,
                "role": "checked",
                "before_rms_mm": check.geometry_alone.rms_mm,
                "after_rms_mm": check.with_effects.rms_mm,
                "held_out_before_rms_mm": check.geometry_alone.rms_mm,
                "held_out_after_rms_mm": check.with_effects.rms_mm,
            }
            for check in self.checks
        ]
        return [plain(one) for one in (learnt, *tried)]

    def to_json(self) -> str:
        """:meth:`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> DiagnosisResult:
        """The diagnosis of such a text, without observations and pictures. Raises ConfigError where it is none."""
        try:
            content = json.loads(text)
        except ValueError as error:
            raise ConfigError(f"the diagnosis is not JSON ({error}); give what mbcacq diagnose --out writes") from error
        if not isinstance(content, dict) or content.get("format") not in READABLE or not isinstance(content.get("fit"), dict):
            raise ConfigError(f"this is no diagnosis of format '{FORMAT}'; give what mbcacq diagnose --out writes")
        if "channels" in content["fit"]:
            return cls(motion=MotionDiagnosis.from_json(content))
        motion = content.get("motion")
        try:
            checks = tuple(Transfer.from_dict(one) for one in content.get("checks", ()))
        except (KeyError, TypeError, AttributeError) as error:
            raise ConfigError(f"the checks of the diagnosis are damaged ({error}); diagnose the recording anew") from error
        return cls(
            Diagnosis.from_json(content),
            None if motion is None else MotionDiagnosis.from_json(motion),
            checks=checks,
            provenance=content.get("provenance"),
        )

    def _drawable(self) -> tuple[Observations, dict[str, Any]]:
        if self.observations is None:
            raise ConfigError("there are no observations to draw; diagnose the recording anew")
        return self.observations, self.pictures()

    def _words_of_poses(self) -> str:
        from mbcacq.diagnosis.output.text import words

        return "" if self.poses is None else words(self.poses)

    def __repr__(self) -> str:
        return "\n".join(repr(found) for found in (self.poses, self.motion) if found is not None)

    def _repr_html_(self) -> str:
        return "".join(found._repr_html_() for found in (self.poses, self.motion) if found is not None)


def diagnose(
    data: Data | Sequence[Data],
    *,
    progress: Callable[[str], None] = lambda text: None,
    workers: int | None = None,
    options: CalibrationOptions | None = None,
    check: Sequence[Observations | Path | str] = (),
    place: str = "fitted",
) -> DiagnosisResult:
    """Find the effects that the model of the cell lacks, and say how sure that is.

    data: observations, or a run folder, a recording, an observation set; or trajectories of one robot (objects or trajectory sets). Several
    recordings of poses of one arm share the arm and its effects, and so do several trajectories. Of a run whose controller recorded
    torques or joint-side angles, the motion between the poses is compared too.
    progress: gets a sentence a step. workers: processes that share the cross-validation (default: one a processor core). options: of the
    adjustment of poses, as :func:`mbcacq.calibrate` takes them (which phases are used, what is held). check: further recordings of the
    arm, on which what was learnt is tried with base, tool and stations fitted, or with ``place`` 'known' nothing.

    Raises ConfigError for data that do not belong together, CalibrationError where they do not determine the geometry.
    """
    several = list(data) if isinstance(data, Sequence) and not isinstance(data, str) else [data]
    if check and all(_is_trajectory(one) for one in several):
        raise ConfigError("what was learnt from trajectories cannot be tried on another recording; leave --check out")
    if all(_is_trajectory(one) for one in several):
        return diagnose_motion([one for one in several if not isinstance(one, Observations)])
    if len(several) > 1:
        return diagnose_together(several, progress, workers, options)
    (one,) = several
    if isinstance(one, Trajectory):
        raise TypeError("a trajectory is diagnosed as motion")
    observations = as_observations(one)
    found = diagnose_poses(observations, progress, workers, options)
    found = replace(found, provenance=provenance(one, check, {"place": place, "workers": workers}))
    if check:
        found = replace(found, checks=tuple(checked(observations, found, other, place, progress) for other in check))
    return found if isinstance(one, Observations) else combined_with_motion(found, Path(one), progress)


def diagnose_together(
    data: Sequence[Data], progress: Callable[[str], None], workers: int | None, options: CalibrationOptions | None
) -> DiagnosisResult:
    """Several recordings of one arm, as one problem; their trajectories, where there are some, together as well. Raises ConfigError."""
    from mbcacq.diagnosis import diagnose as room
    from mbcacq.diagnosis.validation.workers import cores

    motions = [one for one in data if _is_trajectory(one)]
    recordings = [as_observations(one) for one in data if not _is_trajectory(one) and not isinstance(one, Trajectory)]
    if len(recordings) == 1:
        found = diagnose_poses(recordings[0], progress, workers, options)
    else:
        poses = room.diagnose(recordings, progress=progress, workers=workers or cores(), options=options)
        found = DiagnosisResult(poses)
    if motions:
        progress("comparing the motion")
        found = replace(found, motion=diagnose_motion([m for m in motions if not isinstance(m, Observations)]).motion)
    return found


def thinned(observations: Observations) -> Observations:
    """At most as many poses as a diagnosis uses, evenly at random."""
    import numpy as np

    from mbcacq.diagnosis.options import OPTIONS

    if observations.n_poses <= OPTIONS.most_poses:
        return observations
    keep = np.zeros(observations.n_poses, bool)
    rng = np.random.default_rng(0)
    keep[[rng.choice(part) for part in np.array_split(np.arange(observations.n_poses), OPTIONS.most_poses)]] = True
    return observations.select(keep)


def checked(
    learnt: Observations, found: DiagnosisResult, other: Observations | Path | str, place: str, progress: Callable[[str], None]
) -> Transfer:
    """What was found in a recording, tried on another one."""
    from mbcacq.calibration import CalibrationOptions
    from mbcacq.calibration.maximum_likelihood import calibrate
    from mbcacq.calibration.with_effects import calibrate_with_effects

    name = "" if isinstance(other, Observations) else str(other)
    progress(f"trying it on {name or 'the other recording'}")
    options = CalibrationOptions(refuse=False)
    learnt = thinned(learnt)
    cell = calibrate_with_effects(learnt, options, found.model) if found.model else calibrate(learnt, options)
    alone = cell if not found.model else calibrate(learnt, options)
    return check_transfer(as_observations(other), cell, alone.state.chain, place=place, recording=name)


def provenance(data: Data, check: Sequence[Observations | Path | str], options: dict[str, Any]) -> dict[str, Any]:
    """Where a diagnosis comes from: files with their SHA-256, versions of the programs, options."""
    import platform

    import numpy

    from mbcacq.version import __version__

    files = [one for source in (data, *check) if isinstance(source, Path | str) for one in _hashed(Path(source))]
    return {
        "recording": str(data) if isinstance(data, Path | str) else "",
        "files": files,
        "versions": {"mbcacq": __version__, "numpy": numpy.__version__, "python": platform.python_version()},
        "options": options,
    }


def _hashed(source: Path) -> list[dict[str, Any]]:
    """Name, size and SHA-256 of a recording: of the files of an observation set or the parts of a run, not of its clouds."""
    import hashlib

    wanted = {".csv", ".yaml", ".rrd"}
    paths = [source] if source.is_file() else sorted(p for p in source.glob("*") if p.is_file() and p.suffix in wanted)
    out = []
    for path in paths:
        digest = hashlib.sha256()
        try:
            with path.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
        except OSError:
            continue  # a file that went away meanwhile is not part of what was read
        out.append({"file": str(path), "bytes": path.stat().st_size, "sha256": digest.hexdigest()})
    return out


def diagnose_motion(trajectories: Sequence[Trajectory | Path | str]) -> DiagnosisResult:
    """The diagnosis of trajectories of one robot, together. Raises ConfigError where they do not fit together."""
    from mbcacq.diagnosis.motion import diagnose_trajectories

    return DiagnosisResult(motion=diagnose_trajectories(as_trajectories(trajectories)))


def diagnose_poses(
    observations: Observations, progress: Callable[[str], None], workers: int | None, options: CalibrationOptions | None = None
) -> DiagnosisResult:
    """The diagnosis of poses at standstill. Raises CalibrationError."""
    from mbcacq.diagnosis import diagnose as room
    from mbcacq.diagnosis.validation.workers import cores

    found = room.diagnose(observations, progress=progress, workers=workers or cores(), options=options)
    return DiagnosisResult(with_fitted_model(found, observations, progress), observations=observations)


def with_fitted_model(found: Diagnosis, observations: Observations, progress: Callable[[str], None]) -> Diagnosis:
    """The diagnosis with the effects of its model fitted together with the cell, as a calibration would fit them. Where the recording
    does not determine the cell with them, they stay as the diagnosis had them.
    """
    from mbcacq.calibration.with_effects import calibrate_with_effects
    from mbcacq.errors import CalibrationError
    from mbcacq.estimation.options import CalibrationOptions

    if not found.model:
        return found
    progress("fitting the cell with its effects")
    try:
        fitted = calibrate_with_effects(thinned(observations), CalibrationOptions(refuse=False), found.model)
    except CalibrationError as reason:
        return replace(found, notes=(*found.notes, f"the effects could not be fitted with the cell: {reason}"))
    return replace(found, model=fitted.effects)


def combined_with_motion(found: DiagnosisResult, recording: Path, progress: Callable[[str], None]) -> DiagnosisResult:
    """The diagnosis of the poses with that of the motion between them, where a run recorded torques or joint-side angles."""
    from mbcacq.diagnosis.motion import diagnose_trajectories

    if not (is_run_folder(recording) or recording.suffix == ".rrd"):
        return found
    try:
        stretches = recorded_moves(recording)
    except ConfigError:
        return found
    if not stretches:
        return found
    progress("comparing the motion between the poses")
    return replace(found, motion=diagnose_trajectories(stretches))


def _is_trajectory(data: Data) -> bool:
    from mbcacq.recording.datasets.trajectory_set import is_trajectory_set

    return isinstance(data, Trajectory) or (isinstance(data, Path | str) and is_trajectory_set(data))
