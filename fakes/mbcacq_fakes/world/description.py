"""What the fake world needs to know of a cell, as plain arrays that travel into another process."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbcacq_fakes.world.arm import Masses


@dataclass(frozen=True)
class ArtefactFacts:
    """A certificate: centres (B, 3) mm in the artefact's frame, diameters (B,) mm, standard uncertainty of a coordinate."""

    id: str
    balls: tuple[int, ...]
    centres: np.ndarray
    diameters: np.ndarray
    uncertainty_mm: float
    reference_temperature_C: float = 20.0
    expansion_ppm_per_K: float = 1.5
    triangles: np.ndarray | None = None  # (T, 3, 3) mm, of a part: the corners of its surface


@dataclass(frozen=True)
class ScannerView:
    """Frustum of the scanner in its own frame; z points back to the scanner, so near_z > far_z. Half widths (2,) mm along x, y."""

    near_z: float = 55.0
    far_z: float = -55.0
    near_half: np.ndarray = field(default_factory=lambda: np.array([35.5, 49.0]))
    far_half: np.ndarray = field(default_factory=lambda: np.array([50.0, 77.0]))


@dataclass(frozen=True)
class CellFacts:
    """Nominal arm (sign (n,), rows (n, 5), masses), first guess of the hand-eye transform, artefacts, planned stations.

    planned_q: (P, n) rad of the poses to be taken, or none; pace_s: the time from one to the next, roughly. Injected effects
    choose by them the moment at which they begin and the joint on which they act. slides: (n,) bool, prismatic joints; root: (4, 4) of the
    first joint in the base, None: they are one; names: of the axes, E1 .. the external ones.
    """

    sign: np.ndarray
    rows: np.ndarray
    masses: Masses
    gear_ratio: np.ndarray
    hand_eye: np.ndarray
    artefacts: tuple[ArtefactFacts, ...]
    station_ids: tuple[str, ...]
    station_artefact: np.ndarray
    station_pose: np.ndarray
    view: ScannerView = ScannerView()
    planned_q: np.ndarray | None = None
    pace_s: float = 3.0
    slides: np.ndarray | None = None
    root: np.ndarray | None = None
    names: tuple[str, ...] = ()

    @property
    def axes(self) -> tuple[str, ...]:
        """(n,) names of the axes; A1 .. where none are given."""
        return self.names or tuple(f"A{i + 1}" for i in range(self.n))

    @property
    def n(self) -> int:
        return len(self.sign)

    @property
    def planned_poses(self) -> int:
        return 100 if self.planned_q is None else len(self.planned_q)

    @property
    def balls(self) -> tuple[int, ...]:
        return tuple(b for a in self.artefacts for b in a.balls)


def from_cell(cell: Any, field_of_view: Any = None) -> CellFacts:
    """From an mbcacq.model.cell.Cell (duck-typed) and a plan's field_of_view. A station without a pose is put at the base origin."""
    robot, chain = cell.robot, cell.robot.chain
    ids = [a.id for a in cell.artefacts]
    return CellFacts(
        sign=np.array(chain.sign, dtype=float),
        rows=np.stack([chain.theta, chain.d, chain.a, chain.alpha, chain.beta], axis=1).astype(float),
        slides=np.array(chain.prismatic),
        root=chain.root,
        names=tuple(robot.axes),
        masses=Masses(
            np.array(robot.mass, dtype=float),
            np.array(robot.com, dtype=float),
            float(robot.payload_mass),
            np.array(robot.payload_com, dtype=float),
            np.array(robot.gravity, dtype=float),
        ),
        gear_ratio=np.full(len(chain.sign), 100.0) if robot.gear_ratio is None else np.array(robot.gear_ratio, dtype=float),
        hand_eye=np.array(cell.T_flange_scanner, dtype=float),
        artefacts=tuple(
            ArtefactFacts(
                a.id,
                tuple(a.ball_ids),
                np.array(a.centres, dtype=float),
                np.array(a.diameters, dtype=float),
                float(a.uncertainty_mm),
                float(a.reference_temperature_C),
                1.5 if a.expansion_ppm_per_K is None else float(a.expansion_ppm_per_K),
                triangles=_surface(a),
            )
            for a in cell.artefacts
        ),
        station_ids=tuple(str(s.id) for s in cell.stations),
        station_artefact=np.array([ids.index(s.artefact) for s in cell.stations], dtype=int),
        station_pose=np.array([np.eye(4) if s.T_base_station is None else s.T_base_station for s in cell.stations], dtype=float),
        view=ScannerView()
        if field_of_view is None
        else ScannerView(
            float(field_of_view.near_z_mm),
            float(field_of_view.far_z_mm),
            np.array(field_of_view.near_half_mm, dtype=float),
            np.array(field_of_view.far_half_mm, dtype=float),
        ),
    )


def _surface(artefact: Any) -> np.ndarray | None:
    """Corners (T, 3, 3) mm of the triangles of a part: of its mesh, or of the box that stands for it."""
    if artefact.mesh is not None:
        return np.array(artefact.mesh.vertices, dtype=float)[np.array(artefact.mesh.triangles)]
    if artefact.box is None:
        return None
    corner = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, 8).T
    low, high = np.array(artefact.box, dtype=float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # outwards
    triangles = [half for a, b, c, d in faces for half in ((a, b, c), (a, c, d))]
    return (low + corner * (high - low))[np.array(triangles)]
