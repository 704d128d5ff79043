"""The numbers that tune the adaptive choice of poses, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class AdaptiveOptions:
    """Times in s. ``benchmarks/investigate.md`` tries all of it together."""

    # What a measurement takes, where a plan does not say it
    pose_s: float = 6.0  # a motion within a station, settling and a scan
    move_by_hand_s: float = 60.0  # a person carries an artefact to another station, the arm goes home and back
    move_by_positioner_s: float = 20.0
    look_s: float = 20.0  # weighing what a visit showed and choosing the next one, the arm on its way home and back: many short visits cost

    # Candidate views
    views_per_station: int = 12  # random views drawn at each; the measured trial had ten, and more improve the choice by less than a pose
    steepest_deg: float = 40.0

    # Choice of a visit
    fewest: int = 6  # poses of a visit: with fewer the place of the artefact takes most of them, and looks take longer than poses
    most: int = 10  # poses of a visit: what is learnt from them decides about the next one
    stations: int = 6  # whose visits are compared pose by pose: those of which all views together are worth most per second
    rivals: int = 5  # sets of effects beside the most probable one that are to be told from it
    enough: float = 3.0  # natural log of 20: odds of a decision
    spare: float = 2.0  # log odds beyond that are aimed at, since what is expected is a mean
    advised_spare: float = 10.0  # the same for who measures all of it before the next look. Log odds that are expected to grow by m grow by
    # a normal variable of variance 2 m: by 8, they end above 3 nine times in ten. They are expected for the most probable coefficients: for
    # ones that are a standard deviation smaller, of the four or five by which an open effect shows, they grow by 0.6 of it.
    advised_visits: int = 6  # and poses, at most: what five visits with 40 poses did not decide in benchmarks/investigate.md, these may
    advised_poses: int = 48
    least_gain: float = 0.3  # of a further visit of a sequence, less than which is not planned ahead
    sure: float = 7.0  # log evidence that each effect of a verdict must have: information of 20, less what its coefficients cost
    doubtful: float = 0.5  # e-value (odds of an effect, 0.1 beforehand) above which a search does not end with ``none``; with 0.2 a clean
    # cell of 15 went on for 35 poses, and nothing more was found
    excluded: float = 0.8  # share of the catalogue that must be excluded, or be out of reach, before a search ends: what could still hide
    further: float = 0.05  # posterior odds of a further effect beside the named ones, above which a search goes on: those of a decision
    shows: float = 9.0  # information by which an effect of usual size shows: three standard deviations
    repeats: float = 3.0  # times that all reachable views may be measured before separating two sets is given up as futile
    places: float = 1.0  # weight of the log by which the variance at the places that a plan names falls, against one of log odds
    near_mm: float = 250.0  # between such a place and a point that a view sees: farther away no view says anything about it
    hidden: float = 4.0  # weight of the share of the catalogue that is shown, against one of log odds

    # Order of a plan
    first_block: int = 24  # poses after which ``none`` is possible
    second_block: int = 64  # poses that carry what the whole plan does
    views_of_order: int = 16  # random views drawn at each station, beside the plan's own
    values: int = 3  # of a hyper-parameter, of each effect

    columns: int = 6  # combinations of the coefficients of a rival set that are kept, those that displace most first: the others cannot
    # stand in for anything


OPTIONS = AdaptiveOptions()
