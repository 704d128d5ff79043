"""The result of ``mbcacq.diagnose``: of poses, of motion, or of both, with what it can be written to."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from mbcacq.calibration.transfer import Transfer
from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.findings import CURE, READABLE, THE_CONTENT, GivenEvidence
from mbcacq.diagnosis.motion.combine import PosesAndMotion
from mbcacq.diagnosis.motion.result import MotionDiagnosis, is_of_motion
from mbcacq.diagnosis.motion.text import brief_details, motion_details, motion_in_brief, motion_text
from mbcacq.diagnosis.output.brief import brief
from mbcacq.diagnosis.output.pictures import pictures
from mbcacq.diagnosis.output.text import first_sentence, words
from mbcacq.diagnosis.result import Diagnosis, Proposal
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError
from mbcacq.figure import Figure
from mbcacq.model.json_text import fields_as_json, from_document, read_json
from mbcacq.model.observations import Observations
from mbcacq.report.figures import diagnosis_figures
from mbcacq.report.sources.from_diagnosis import diagnosis_content
from mbcacq.report.sources.from_motion import motion_pictures
from mbcacq.report.write import write_diagnosis_page
from mbcacq.simulation.model_match import ModelMatch
from mbcacq.version import __version__
from mbcacq.workflow.diagnosis_document import BEFORE_VERSION_3, BesidePoses, Provenance, RecordingFigures
from mbcacq.workflow.effect_draft import write_draft

HOW_LOCATED = "Along the recorded motion, by which a mismatch is located; these estimates are linear, and the runs above decide:"


@dataclass(frozen=True, repr=False, kw_only=True)
class DiagnosisResult:
    """What a diagnosis found. It pickles, with its pictures.

    Attributes
    ----------
    poses, motion
        The diagnosis of the poses at standstill, and that of the motion; at least one of them is there.
    observations
        The diagnosed observations; None if the diagnosis was read from JSON.
    given_motion
        The evidence of the poses, with the motion's certain effects as their prior.
    checks
        What was learnt, tried on other recordings.
    provenance
        The files (name, bytes, SHA-256), the versions of the programs, the options.
    simulation
        The MuJoCo model with which the recording was compared, and what was found written into it.
    """

    poses: Diagnosis | None = None
    motion: MotionDiagnosis | None = None
    observations: Observations | None = None
    given_motion: GivenEvidence | None = None
    checks: tuple[Transfer, ...] = ()
    provenance: Provenance | None = None
    simulation: ModelMatch | None = None

    @property
    def main(self) -> Diagnosis | MotionDiagnosis:
        """The diagnosis whose verdict counts: of the poses, otherwise of the motion."""
        found = self.poses or self.motion
        if found is None:
            raise ConfigError("this diagnosis is of nothing; diagnose a recording with mbcacq.diagnose")
        return found

    @property
    def model(self) -> EffectModel | None:
        """The effects found in the poses as terms that ``mbcacq.calibrate`` takes; None where there are none."""
        return self.poses.model if self.poses is not None else None

    @property
    def verdict(self) -> str:
        """'none', 'explained', 'partly_explained', 'unexplained' or 'cannot_tell'; of poses and motion together if there are both."""
        return self.main.verdict if self.both is None else self.both.verdict

    @cached_property
    def both(self) -> PosesAndMotion | None:
        """Poses and motion as one problem, if there are both."""

        return None if self.poses is None or self.motion is None else PosesAndMotion(self.poses, self.motion, self.given_motion)

    @property
    def effects(self) -> Sequence[EffectFound]:
        """The effects found, the largest first: name, where, parameters (value and std by name), p_value, held_out_gain, alternatives."""
        return self.main.effects

    @property
    def proposals(self) -> Sequence[Proposal]:
        """Formulas for unmodelled effects, where they were asked for, the most probable of each location first."""
        return self.poses.proposals if self.poses is not None else ()

    def write_effect(self, folder: Path | str) -> list[Path]:
        """Write the most probable formulas as a package that adds them to the catalogue (``pip install FOLDER``).

        Parameters
        ----------
        folder
            The folder of the package.

        Returns
        -------
        list of Path
            The files.

        Raises
        ------
        ConfigError
            No formula was found, or the folder holds something already.
        """
        return write_draft(self.proposals, Path(folder))

    @property
    def text(self) -> str:
        """The diagnosis in plain sentences, as the command line prints it."""
        return self.in_words()

    def in_words(self, calibrated: bool = False, whole: bool = False) -> str:
        """The diagnosis in plain sentences, as ``text``.

        Parameters
        ----------
        calibrated
            The cell was calibrated with what was found; the next step follows that.
        whole
            With all figures, limits and notes; otherwise on one screen.

        Returns
        -------
        str
            Several lines.
        """
        if self.motion is not None and self.simulation is not None and self.simulation.verdict is not None:
            details = motion_details(self.motion) if whole else "\n".join(brief_details(self.motion))
            return "\n".join([first_sentence(self.motion), self.simulation.text, "", HOW_LOCATED, "", details])
        of_motion = "" if self.motion is None else (motion_text if whole else motion_in_brief)(self.motion)
        written = [] if self.simulation is None else [self.simulation.text]
        if self.poses is None:
            return "\n".join([of_motion, *written])
        text = (words if whole else brief)(self.poses, calibrated)
        text = text if self.both is None else self.both.in_words(text, of_motion)
        return "\n".join([text, *(check.text for check in self.checks), *written])

    def pictures(self) -> dict[str, Any]:
        """What the pictures need: the evidence map, residuals before and after (mm), curves, and the channels of the motion over time.

        Returns
        -------
        dict
            Format 'mbcacq-diagnosis-pictures/1'.

        Raises
        ------
        ConfigError
            The diagnosis is of trajectories alone, or was read from JSON.
        """
        if self.poses is None or self.poses.plot_data is None:
            raise ConfigError("pictures are drawn from the diagnosis of poses, as mbcacq.diagnose returns it")
        drawn = pictures(self.poses)
        if self.motion is not None:
            drawn["motion"] = motion_pictures(self.motion)
        return drawn

    def plot(self, curve: int | None = None) -> Figure:
        """The evidence map by location and covariate, or a response curve.

        Parameters
        ----------
        curve
            Number of the response curve, in the order of the effects found; None for the evidence map.

        Returns
        -------
        Figure
            A figure for a notebook.

        Raises
        ------
        ConfigError
            There is no such curve, or as ``pictures``.
        """
        pictures = self.pictures()
        figures = {} if self.poses is None else diagnosis_figures(diagnosis_content(self.poses, pictures))
        name = "evidence_map" if curve is None else f"response_{curve}"
        if name not in figures:
            raise ConfigError(f"there are {sum(k.startswith('response_') for k in figures)} response curves, none has the number {curve}")
        return figures[name]

    def write_html(self, path: Path | str) -> Path:
        """Write the diagnosis as one HTML page that opens offline: of poses, of motion with its channels over time, or of both.

        Parameters
        ----------
        path
            The file.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ConfigError
            The diagnosis was read from JSON.
        """
        pictures = None if self.poses is None else self.pictures()
        return write_diagnosis_page(self.poses, pictures, path, about=self._about(), motion=self.both or self.motion, checks=self.checks)

    def _about(self) -> list[tuple[str, str]]:
        """Robot, data and date, as the page names them."""

        data = (self.provenance.recording if self.provenance else None) or ""
        out = [] if self.observations is None else [("robot", self.observations.cell.robot.name)]
        if self.observations is not None:
            out.append(("poses", f"{self.observations.n_poses}, with {self.observations.n_centres} centres"))
        elif self.motion is not None:
            series = self.motion.series
            out, data = [("robot", series.robot)], ", ".join(filter(None, series.recordings))
        out += [("data", data)] if data else []
        return [*out, ("diagnosed", f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"), ("software", f"mbcacq {__version__}")]

    def write_rrd(self, path: Path | str) -> Path:
        """Write a recording for the rerun viewer: arrows before and after in the cell, and the channels of the motion over time.

        Parameters
        ----------
        path
            The file.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ConfigError
            The diagnosis was read from JSON.
        RecordingError
            The file cannot be written.
        """
        from mbcacq.workflow.diagnosis_files import cards_of, write_motion_rrd, write_rrd

        if self.poses is None and self.motion is not None:
            return write_motion_rrd(self.motion, Path(path))
        poses, observations, drawn = self._drawable()
        write_rrd(observations, cards_of(poses), drawn, Path(path), self.motion)
        return Path(path)

    def keep(self, run: Path | str) -> None:
        """Write the diagnosis of a run's poses, and of the motion between them, into the run's folder, where report and viewer find it.

        Parameters
        ----------
        run
            The run folder.

        Raises
        ------
        RecordingError
            The files cannot be written.
        """
        from mbcacq.workflow.diagnosis_files import cards_of, keep_in_run

        poses, observations, drawn = self._drawable()
        keep_in_run(self.to_dict(), cards_of(poses), drawn, observations, Path(run))

    def to_dict(self) -> dict[str, Any]:
        """The JSON content (see ``mbcacq.diagnosis.schema.diagnosis_schema``). The motion has its own key if there are poses and motion.

        Returns
        -------
        dict
            Format 'mbcacq-diagnosis/3'.
        """
        content = self.main.to_json()
        if self.poses is None:
            return content | ({} if self.simulation is None else {"simulation": fields_as_json(self.simulation)})
        origin = self.provenance or Provenance()
        beside = BesidePoses(
            simulation=self.simulation,
            recordings=(RecordingFigures.learnt(origin.recording or "", self.poses.fit), *map(RecordingFigures.checked, self.checks)),
            checks=self.checks,
            provenance=origin,
        )
        return content | fields_as_json(beside) | ({} if self.both is None else self.both.to_json())

    def to_json(self) -> str:
        """``to_dict`` as JSON text.

        Returns
        -------
        str
            Text that ``from_json`` takes.
        """
        return json.dumps(self.to_dict(), indent=1, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> DiagnosisResult:
        """The diagnosis of a JSON text, without observations and pictures.

        Parameters
        ----------
        text
            Text that ``to_json`` wrote, of this or an earlier version.

        Returns
        -------
        DiagnosisResult
            The diagnosis.

        Raises
        ------
        ConfigError
            The text is no diagnosis.
        """
        content = read_json(text, "the diagnosis", CURE)
        whole = BEFORE_VERSION_3 | content if isinstance(content, dict) else content
        beside = from_document(BesidePoses, whole, READABLE, THE_CONTENT, "diagnosis", CURE)
        if is_of_motion(content):
            return cls(motion=MotionDiagnosis.from_json(content), simulation=beside.simulation)
        return cls(
            poses=Diagnosis.from_json(content),
            motion=beside.motion,
            given_motion=beside.given_motion,
            checks=beside.checks,
            provenance=beside.provenance,
            simulation=beside.simulation,
        )

    def _drawable(self) -> tuple[Diagnosis, Observations, dict[str, Any]]:
        if self.poses is None or self.observations is None:
            raise ConfigError("there are no observations to draw; diagnose the recording anew")
        return self.poses, self.observations, self.pictures()

    def __repr__(self) -> str:
        return "\n".join(repr(found) for found in (self.poses, self.motion) if found is not None)

    def _repr_html_(self) -> str:
        return "".join(found._repr_html_() for found in (self.poses, self.motion) if found is not None)
