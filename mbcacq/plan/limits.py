"""The numbers that tune planning, each with its reason. What a user may choose for one cell stands in the plan's YAML instead."""

from __future__ import annotations

from dataclasses import dataclass

from mbcacq.quantities import DEGREE


@dataclass(frozen=True, kw_only=True)
class PlanningLimits:
    """Angles in rad, lengths in mm, times in s.

    The margin to a joint limit and the bend of the wrist have two values each: the choice of a joint position starts to avoid what the
    check of a pose only warns of. A design, which may leave a view out, has a third one (``DesignOptions``).
    """

    # Choice among the joint positions that reach a target.
    preferred_limit_margin: float = 5.0 * DEGREE  # from here on a position costs more, up to ``poor_posture_s`` at the limit
    preferred_wrist_bend: float = 12.0 * DEGREE  # |A5| below which a position costs more: A4 and A6 turn about nearly one line
    poor_posture_s: float = 20.0  # cost of a position at a limit, or of a straight wrist: more than any motion takes
    reach_back_s: float = 20.0  # cost of reaching over the arm's back where home does not: more than any motion takes
    mean_joint_share: float = 0.2  # of the mean joint time added to the slowest joint's: decides between motions of equal duration
    selection_rounds: int = 25  # of leaving out positions that are too close or without a free path, and choosing anew
    most_positions: int = 96  # that reach one target, those nearest home: others differ by full turns, which only wind up cables
    assumed_top_speed: float = 180.0 * DEGREE  # rad/s in that cost, for an arm without stated speeds

    # Execution.
    shortest_acceleration_time_s: float = 0.25  # to full speed, of an arm without stated accelerations: a guess that errs on the slow side
    shortest_jerk_time_s: float = 0.05  # to full acceleration, without stated jerks: several periods of an arm's lowest vibration

    # Warnings about a single pose.
    near_limit: float = 2.0 * DEGREE  # a pose closer to a limit leaves no room to correct it
    singular_angle: float = 5.0 * DEGREE  # of wrist and elbow: closer, joint speeds exceed tool speeds more than tenfold
    shoulder_singular_mm: float = 30.0  # from the wrist to axis 1
    repeated_pose: float = 0.01 * DEGREE  # poses that differ by less are one pose

    # What the scanner can see.
    steepest_view: float = 70.0 * DEGREE  # between the scanner's axis and the artefact's: beyond, it looks at the plate's edge
    hidden_share: float = 0.6  # of the sum of two radii: balls that appear closer together leave too little of the far one

    # Clearance along a motion.
    finest_travel_mm: float = 4.0  # a motion is divided until nothing moves further between two examined postures
    random_postures: int = 400  # bodies of the arm that overlap in all of them do so by the shape of the model, and are no collision
    neighbour_gap_mm: float = 10.0  # neighbouring links need not overlap to be left out, only to be never farther apart than this
    smallest_part_mm: float = 40.0  # into which the scanner is divided where it overlaps with a link in every posture

    # Detours.
    retractions_mm: tuple[float, ...] = (80.0, 160.0, 260.0)  # tried in turn, along the scanner's axis away from the artefact
    farthest_retraction: float = 75.0 * DEGREE  # of one joint; a larger one means another branch of the arm

    # The cell as simple solids.
    link_radius_shares: tuple[float, ...] = (0.07, 0.07, 0.05, 0.05, 0.04)  # of the reach, links 1, 2...; later links as the last
    plate_mm: float = 40.0  # thickness of what carries the balls, below the lowest of them
    artefact_side_mm: float = 8.0  # of the plate around the outermost balls
    shortest_body_mm: float = 5.0  # a shorter part of a link is no body of its own
    wall_mm: float = 5000.0  # thickness of a workspace limit: more than any arm reaches
    deepest_tripod_mm: float = 400.0  # height of a tripod where the plan names no floor

    # Preview of a whole run.
    preview_step: float = 2.0 * DEGREE  # between two places in the swept box and speed, not in the clearance
    limit_rounding: float = 1e-9  # a waypoint at a limit may exceed it by rounding
