"""The numbers that tune a design and its predictions, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

from mbcacq.quantities import DEGREE

SixSigmas = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class DesignOptions:
    """Angles in rad unless a name says deg, lengths in mm.

    A candidate view is taken only with more room to the joint limits and more bend of the wrist than the check of a plan asks for
    (``PlanningLimits``): there are always others to choose from.
    """

    # Candidate views.
    views_per_station: int = 220  # random views drawn at each, of which some can be taken
    limit_margin: float = 4.0 * DEGREE  # of every axis, twice what the check warns of
    wrist_bend: float = 8.0 * DEGREE  # least |A5|
    spare_clearance_mm: float = 5.0  # beyond the plan's clearance: leaves the motions to a view some room
    shifts_mm: tuple[float, float, float] = (16.0, 24.0, 20.0)  # largest shift of the aim in the view, along x, y, z
    fewest_balls: int = 4  # that a view must show, or all where the artefact has fewer

    # Views of a part.
    part_views: int = 600  # random views, of which some can be taken
    surface_points: int = 4000  # of which each stands for as much surface
    flattest_deg: float = 60.0  # incidence: beyond, a scanner sees little and noisily
    coverage: float = 0.98  # of what can be seen at all
    overlap: float = 0.3  # of the smaller view, with which two views hang together

    # Optimal design.
    exchange_rounds: int = 4  # exchanges tried at most, per chosen pose
    least_improvement: float = 1e-6  # of the criterion, relative: a smaller one ends the exchange
    station_sigmas: SixSigmas = (50.0, 50.0, 50.0, 0.2, 0.2, 0.2)  # mm, rad: vague knowledge of a station's pose, for a finite start

    # Simulated cells: errors (1 sigma) of a usual arm against its data sheet, and of a usual assembly.
    simulated_cells: int = 40
    parameter_errors: tuple[float, float, float, float, float] = (5e-4, 0.15, 0.15, 2e-4, 1.5e-4)  # theta, d, a, alpha, beta
    mounting_errors: SixSigmas = (1.0, 1.0, 1.0, 5e-3, 5e-3, 5e-3)  # mm, rad: hand-eye and stations

    # Predictions.
    standstill: float = 1e-4  # a joint that travels less keeps its last direction of rotation
    weak_mm: float = 0.1  # uncertainty of a point somewhere in reach that deserves a warning
    detectable_sigmas: float = 6.0  # of its own uncertainty: an effect of usual size is then reliably found among many
    indistinguishable: float = 0.95  # correlation of two effects from which on they look alike
    hyperparameters_tried: int = 7  # values of an effect's hyper-parameter, of which the median detectability counts


OPTIONS = DesignOptions()
