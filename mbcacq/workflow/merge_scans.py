"""The scans of a part in a recording, merged by the calibrated cell."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_file
from mbcacq.files.mesh_file import read_mesh
from mbcacq.geometry.flange_poses import FlangePoses
from mbcacq.model import yaml12
from mbcacq.model.observations import Observations
from mbcacq.parts.agreement import Agreement, agreement, offsets
from mbcacq.parts.cad import CadDeviations, compare_with_cad
from mbcacq.parts.merge import Merged, merge
from mbcacq.parts.options import PartOptions
from mbcacq.parts.placement import CommonMotion, placements
from mbcacq.plan.schema import StationPlace
from mbcacq.quantities import capitalised
from mbcacq.recording import load_observations
from mbcacq.workflow.load import as_cell
from mbcacq.workflow.part_scenes import scans_at, stations_of_parts, thinned_scans

VOXELS_PER_SPACING = 1.0
SAME_POSE = 1e-3  # rad: joint angles that differ by less are one view
EXAGGERATED = 30.0  # how far scans are off in the viewer: a millimetre of a part is seen, a hundredth is not


@dataclass(frozen=True)
class MergedPart:
    """What was made of the scans of a part: where it stood, its cloud, and how well its scans agree."""

    station: str
    cloud: Path
    merged: Merged
    agreement: Agreement
    voxel_mm: float
    simulated: bool
    scans: dict[str, np.ndarray]  # name of a placement -> (g, 4) of ``offsets``
    deviations: CadDeviations | None = None

    def to_dict(self) -> dict[str, Any]:
        return {
            "format": "mbcacq-merge/1",
            **({"simulated": True} if self.simulated else {}),
            "station": self.station,
            "cloud": str(self.cloud),
            "voxel_mm": self.voxel_mm,
            "scans": self.merged.scans,
            "points": {"read": self.merged.read, "kept": self.merged.kept},
            "sigma_mm": {"median": self.merged.sigma_mm, "largest": self.merged.worst_mm},
            "agreement": self.agreement.to_dict(),
            **({} if self.deviations is None else {"cad": self.deviations.to_dict()}),
        }

    def write(self, stem: Path) -> list[Path]:
        """Write STEM.json, all figures, and STEM.rrd, all of it for the viewer. Raises RecordingError."""
        from mbcacq.recording.rrd.part_recording import PartDrawn, write_part

        pairs, cad = self.agreement.pairs, self.deviations
        best = self.agreement.names[-1]
        drawn = PartDrawn(
            text="\n\n".join(capitalised(one.sentence) for one in (self.agreement, cad) if one is not None),
            scans={"before": self.scans[self.agreement.names[0]], "after": self.scans[best]},
            times=EXAGGERATED,
            centres=np.array([pair.step.centre for pair in pairs]),
            steps=np.array([pair.step.twist[:3] for pair in pairs]),
            share=np.array([pair.by_placement[best] / pair.expected_mm for pair in pairs]),
            deviations=None if cad is None else cad.drawn,
            U_mm=0.0 if cad is None else cad.U_mm,
        )
        written = write_part(stem.with_suffix(".rrd"), drawn)
        return [write_file(stem.with_suffix(".json"), json.dumps(self.to_dict())), written]


def merge_scans(
    source: Path | str,
    out: Path | str,
    *,
    result: CalibratedCell | dict[str, Any] | Path | str | None = None,
    station: str | None = None,
    voxel_mm: float | None = None,
    cad: Path | str | None = None,
    fit: bool = True,
    progress: Callable[[str], None] = lambda sentence: None,
) -> MergedPart:
    """Place all scans of a part by a calibrated cell, compare them where they overlap, and write them as one cloud.

    Parameters
    ----------
    source
        Run folder, or observation set with ``scans/POSE.ply``.
    out
        The PLY to write: base frame, mm; with normals, ``sigma_mm`` and ``sigma_base_mm`` (standard uncertainty along the normal, within
        the part and in the base frame) and ``scan`` (number of the pose).
    result
        The calibrated cell; default: that of the run.
    station
        Where the part stood; needed where parts stood at several.
    voxel_mm
        In each voxel of this edge the best known point stays; default: the spacing of a scan's points.
    cad
        Mesh of the part's design in mm, with which the cloud is compared.
    fit
        Compare at the best fit; else where the plan says that the part stands.

    Raises
    ------
    ConfigError
        The recording holds no part, its scans do not overlap, or the result is of another arm.
    """

    o = PartOptions()
    source, out = Path(source), Path(out)
    design = None if cad is None else read_mesh(cad)
    cell = as_cell(source if result is None else result)
    observations = load_observations(source)
    if isinstance(cell.nominal, FlangePoses):
        raise ConfigError("scans are merged by joint angles, and this result is of poses of a flange; place them with mbcacq apply --poses")
    if observations.q.shape[1] != cell.nominal.n:
        raise ConfigError("the result and the recording are of different arms; give the result of this cell")
    station = _station(observations, station)
    scans = scans_at(source, observations, station)
    progress("comparing the scans where they overlap")
    seen, apart = thinned_scans(source, observations, station)
    if len(seen) > 1 and np.ptp([scan.q for scan in seen], axis=0).max() < SAME_POSE:
        raise ConfigError("all scans were taken at the same joint angles, which shows nothing of the cell; scan the part from all sides")
    ways = placements(cell)
    compared = agreement(seen, ways, o)
    voxel = voxel_mm or VOXELS_PER_SPACING * apart
    progress("merging them")
    noise = compared.scatter_mm, compared.noise.sigma_mm / np.sqrt(2)  # the distance of two scans has the noise of both
    common = CommonMotion.of(ways[-1], [(scan.q, scan.points[:: max(1, len(scan.points) // 30)]) for scan in seen])
    drawn = {way.name: offsets(seen, way, EXAGGERATED, o) for way in (ways[0], ways[-1])}
    del seen
    merged = merge(scans, ways[-1], common, noise, voxel, out, o, simulated=observations.cell.simulated)
    deviations = None
    if design is not None:
        progress("comparing with the design")
        deviations = compare_with_cad(out, design, _planned_place(source, station), o, fit=fit)
    return MergedPart(
        station=station,
        cloud=out,
        merged=merged,
        agreement=compared,
        voxel_mm=voxel,
        simulated=observations.cell.simulated,
        scans=drawn,
        deviations=deviations,
    )


def _planned_place(source: Path, station: str) -> np.ndarray:
    """T_base_part (4, 4) of a run's plan or of an observation set's cell. Raises ConfigError where neither says it."""
    text = source / "plan.yaml"
    if text.is_file():
        places = yaml12.load(text.read_text(encoding="utf-8")).get("stations", ())
        found = next((StationPlace.model_validate(one) for one in places if str(one.get("id")) == station), None)
        if found is not None:
            return found.pose_in_base.transform()
    placed = load_observations(source).cell.station(station).T_base_station
    if placed is None:
        raise ConfigError(f"nothing says where station '{station}' is; give its pose_in_base in cell.yaml, roughly")
    return placed


def _station(observations: Observations, wanted: str | None) -> str:
    """Where the part stood. Raises ConfigError where that is not one station."""
    known = [s.id for s in observations.cell.stations]
    if wanted is not None:
        if wanted not in known:
            raise ConfigError(f"there is no station '{wanted}' (there: {', '.join(known)}); name one of these")
        return wanted
    parts = stations_of_parts(observations)
    if len(parts) != 1:
        what = f"parts were scanned at {', '.join(parts)}" if parts else "no part was scanned, only artefacts"
        raise ConfigError(f"{what}; say whose scans are meant by --station (there: {', '.join(known)})")
    return parts[0]
