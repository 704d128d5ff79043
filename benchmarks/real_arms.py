"""Recordings of real arms, from outside: what is learnt on one tried on another, compliances of two days, mistakes in descriptions.

    python benchmarks/real_arms.py transfer [--data ../shared/data] [--poses 1500] [--only ur10] [--write]
    python benchmarks/real_arms.py compliance [--poses 1500] [--write]
    python benchmarks/real_arms.py wrong-descriptions > benchmarks/wrong_descriptions.md

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bench
import numpy as np
from bench import DATA, HERE, ROOT, option, put, table, writes
from scipy.spatial import KDTree

import mbcacq
from mbcacq.calibration.maximum_likelihood import calibrate_with_effects
from mbcacq.calibration.transfer import check_transfer
from mbcacq.calibration.with_effects import own_joint
from mbcacq.description import wrong_descriptions
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm, LearntRecording
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.parameters import Estimate, build
from mbcacq.estimation.solver import system
from mbcacq.model.observations import Observations
from mbcacq.recording import load_observations

OFF_GRID = 20


def some(obs: Observations, poses: int) -> Observations:
    """At most so many poses, at random."""
    keep = np.zeros(obs.n_poses, bool)
    keep[np.random.default_rng(0).permutation(obs.n_poses)[:poses]] = True
    return obs.select(keep)


def learnt(obs: Observations) -> tuple[mbcacq.CalibratedCell, mbcacq.CalibratedCell]:
    """The cell with what a diagnosis finds, and as geometry alone."""
    options = mbcacq.CalibrationOptions(refuse=False)
    geometry = replace(options, discrepancy=False, random_links=False)
    model = diagnose(obs).model
    cell = mbcacq.calibrate(obs, options) if model is None else calibrate_with_effects(obs, options, model)
    return cell, mbcacq.calibrate(obs, geometry)


def tried(cell: mbcacq.CalibratedCell, alone: mbcacq.CalibratedCell, other: Observations, name: str) -> str:
    """The figures on a recording, as one row."""
    found = check_transfer(replace(other, pose_id=other.pose_id + 10**6), cell, alone.state.chain)
    own = found.own_geometry.rms_mm if found.own_geometry else float("nan")
    error = found.normalised_error
    row = (
        f"| {name} | {own:.3f} | {found.geometry_alone.rms_mm:.3f} | {found.with_effects.rms_mm:.3f} | {error.rms:.2f} | "
        f"{error.share_below_3:.1%} | {joints(cell)} |"
    )
    print(row, flush=True)
    return row


def joints(cell: mbcacq.CalibratedCell) -> str:
    """The joints that share a pattern of error, with their offsets."""
    pattern = cell.extra.get("common_pattern")
    if not pattern:
        return "none"
    each = zip(pattern["joints"], pattern["offset"], pattern["direction"], strict=True)
    return ", ".join(f"A{j + 1} {np.degrees(o):.0f} deg{'' if d > 0 else ' mirrored'}" for j, o, d in each)


def ur5(data: Path) -> list[str]:
    """Learnt on a random half of the grid, checked on the rest, and on the poses farthest from any learnt one."""
    grid = mbcacq.load_observations(data / "ur5-tracker")
    half = np.zeros(grid.n_poses, bool)
    half[np.random.default_rng(1).permutation(grid.n_poses)[:700]] = True
    cell, alone = learnt(grid.select(half))
    rows = [tried(cell, alone, grid.select(~half), "ur5-tracker, 700 poses -> 300")]
    distance = KDTree(grid.q[half]).query(grid.q[~half])[0]
    far = np.zeros(grid.n_poses, bool)
    far[np.flatnonzero(~half)[np.argsort(-distance)[:OFF_GRID]]] = True
    return [*rows, tried(cell, alone, grid.select(far), f"ur5-tracker -> the {OFF_GRID} farthest of these")]


def ur10(data: Path, poses: int) -> list[str]:
    """Each campaign checked by the other."""
    campaigns = {name: some(mbcacq.load_observations(data / f"ur10-tracker-{name}"), poses) for name in "ac"}
    rows = []
    for here, there in (("a", "c"), ("c", "a")):
        cell, alone = learnt(campaigns[here])
        rows.append(tried(cell, alone, campaigns[there], f"ur10-tracker-{here} -> {there}"))
    return rows


HEADER = (
    "| learnt -> checked | geometry fitted there mm | learnt geometry mm | with effects mm | error over uncertainty, rms | below 3 | one "
    "pattern in |"
)


def transfer(given: argparse.Namespace) -> None:
    """Learn here, check there: an arm with its effects on recordings that it was not fitted to.

    UR10: learnt on one campaign, checked on the other, both ways (base, tool and stations of the other fitted). UR5: learnt on a
    700-pose half of its grid, checked on the rest, and on the 20 poses that lie farthest from any learnt pose in the joints.
    """
    head = [HEADER, "|---|---|---|---|---|---|---|"]
    print(*head, sep="\n", flush=True)
    rows = ur5(given.data) if given.only != "ur10" else []
    rows += ur10(given.data, given.poses) if given.only != "ur5" else []
    if given.write:
        put(HERE / "transfer.md", "\n".join([*head, *rows]))


FEW = 600  # poses that tell the noise
OWN_SIZE = 0.12  # of the prior of a joint's own error: what marginal likelihood gives, 0.10 to 0.16 for all joints but A6 of series A
MODELS = {
    "compliance alone": ("compliance",),
    "and each joint's own error to order 60": ("compliance", "own"),
    "and what its movement leaves behind": ("compliance", "own", "movement"),
    "and links and base that tilt under the weight behind them": ("compliance", "own", "movement", "tilt"),
}


JOINTS = (2, 3)
PAGE = ROOT / "docs" / "data" / "ur10-tracker.md"
BEGIN, AFTER = "<!-- compliance -->\n", "<!-- end of compliance -->\n"


def kind(t: EffectTerm) -> str:
    """'own' error of a joint, by its 'movement', its 'compliance', or 'tilt' of a link or the base."""
    if t.depends_on.startswith("movement_"):
        return "movement"
    return "own" if own_joint(t) is not None and t.k > 1 else "compliance" if t.where[0][0] == "A" else "tilt"


def compliances(obs: Observations, poses: int) -> list[list[str]]:
    """For each model the compliance of each of JOINTS with its standard deviation, urad/Nm, and the misfit."""
    options = mbcacq.CalibrationOptions(refuse=False)
    noise = learnt(some(obs, FEW))[0].noise
    obs = some(obs, poses)
    alone = mbcacq.calibrate(obs, options)
    terms = tuple(unmodelled.everywhere(Covariates(obs)))
    model = EffectModel(obs.cell.robot, terms, LearntRecording.of(obs), obs.cell.measurement)
    asked = replace(options, terms=model.at(obs))
    layout = build(obs, asked)
    for name, why in alone.layout.held.items():
        layout = layout if name in layout.held else layout.hold(name, why)
    start = Estimate(alone.state, tuple(np.zeros(t.k) for t in terms))
    at = system(Lineariser(obs, layout, asked), start, noise, alone.fit.weights)
    information = at.normal.information - np.diag(layout.gather("sigma") ** -2.0)
    of = {name: (kind(t), sigma) for t in terms for name, sigma in zip(t.names, t.sigma, strict=True)}
    rows = []
    for wanted in MODELS.values():
        scale = layout.gather("scale").copy()
        free = np.ones(len(scale), bool)
        weight = np.zeros(len(scale))
        for j, name in enumerate(layout.names):
            if name in of:
                which, sigma = of[name]
                free[j] = which in wanted
                weight[j] = (sigma * (OWN_SIZE if which == "own" else 1.0)) ** -2.0
        S = scale[:, None] * (information + np.diag(weight)) * scale
        inverse = np.linalg.inv(S[np.ix_(free, free)])
        value = inverse @ (scale * at.normal.gradient)[free]
        cost = at.cost - value @ (scale * at.normal.gradient)[free]
        misfit = max(float(np.sqrt(cost / (obs.n_centres * 6))), 1.0)
        value, std = value * scale[free], np.sqrt(np.diag(inverse)) * scale[free] * misfit
        names = [name for name, keep in zip(layout.names, free, strict=True) if keep]
        found = [names.index(f"unknown:A{i}:gravity_torque_{i}[0]") for i in JOINTS]
        rows.append([f"{1e6 * value[j]:.1f} +- {1e6 * std[j]:.1f}" for j in found] + [f"{misfit:.2f}"])
        print(wanted, *rows[-1], flush=True)
    return rows


def compliance(given: argparse.Namespace) -> None:
    """The compliance of the UR10's joints in two campaigns, and how much of a difference is the model's.

    Each campaign is linearised at its geometry, with the noise that is left beside all groups; the compliances are fitted with the
    geometry, then with each joint's own errors, with what its movement from the pose before leaves behind, and with links and base
    that tilt under the weight behind them. Standard deviations are scaled by the misfit.
    """
    each = [compliances(mbcacq.load_observations(given.data / f"ur10-tracker-{name}"), given.poses) for name in "ac"]
    heads = [f"{what}, series {name}" for name in "AC" for what in (*(f"A{i}" for i in JOINTS), "misfit")]
    rows = [[model, *a, *c] for model, a, c in zip(MODELS, *each, strict=True)]
    lines = "\n".join(table(["model beside the geometry", *heads], rows))
    print(lines)
    if given.write:
        put(PAGE, lines, BEGIN, AFTER)


def poses(most: int) -> bench.Option:
    return option("--poses", type=int, default=most, help="of each campaign, at random")


CALL = "python benchmarks/real_arms.py wrong-descriptions"
Mistake = Callable[[Observations], Observations]


FIRST, SECOND, THIRD = "ur10-tracker-c", "ur5-tracker", "example-none"


def reversed_axis(j: int) -> Mistake:
    return lambda o: replace(o, q=o.q * np.where(np.arange(o.q.shape[1]) == j, -1.0, 1.0))


def offset(j: int, degrees: float) -> Mistake:
    return lambda o: replace(o, q=o.q + np.radians(degrees) * np.eye(o.q.shape[1])[j])


def exchanged(i: int, j: int) -> Mistake:
    def mistake(o: Observations) -> Observations:
        order = np.arange(o.q.shape[1])
        order[[i, j]] = j, i
        return replace(o, q=o.q[:, order])

    return mistake


def points(factor: float | list[float]) -> Mistake:
    return lambda o: replace(o, xyz=o.xyz * factor)


def point_columns(*order: int) -> Mistake:
    """The file has the columns in this order."""
    return lambda o: replace(o, xyz=o.xyz[:, np.argsort(order)])


def in_radians(o: Observations) -> Observations:
    return replace(o, q=np.radians(o.q))


def left_handed(o: Observations) -> Observations:
    assert o.rotation is not None
    mirror = np.diag([1.0, -1.0, 1.0])
    return replace(o, rotation=mirror @ o.rotation @ mirror)


def inverted(o: Observations) -> Observations:
    assert o.rotation is not None
    return replace(o, rotation=np.swapaxes(o.rotation, 1, 2))


def certified_mirrored(o: Observations) -> Observations:
    artefacts = tuple(replace(a, centres=a.centres * [1, -1, 1]) for a in o.cell.artefacts)
    return replace(o, cell=replace(o.cell, artefacts=artefacts))


def counted_from_the_horizontal(o: Observations) -> Observations:
    q = o.q.copy()
    q[:, 2] += q[:, 1]
    return replace(o, q=q)


CASES: tuple[tuple[str, str, Mistake, str], ...] = (
    (FIRST, "A6 counted the other way round", reversed_axis(5), "A6 reversed"),
    (FIRST, "A3 counted the other way round", reversed_axis(2), "A3 reversed"),
    (FIRST, "A2 90 deg off", offset(1, 90), "-90 deg added to A2"),
    (FIRST, "A4 180 deg off", offset(3, 180), "+180 deg added to A4"),
    (FIRST, "angles in radians", in_radians, "the angles read as radians, not degrees (are the columns q1_rad .. and not q1_deg ..?)"),
    (FIRST, "points in metres", points(1e-3), "the measured points read as metres, not millimetres"),
    (FIRST, "orientation left-handed", left_handed, "the orientation mirrored along y (left-handed)"),
    (FIRST, "orientation inverted", inverted, "the orientation inverted"),
    (FIRST, "columns of A4 and A5 exchanged", exchanged(3, 4), "the columns of A4 and A5 exchanged"),
    (FIRST, "y of the points reversed", points([1, -1, 1]), "y of the measured points reversed"),
    (SECOND, "A1 counted the other way round", reversed_axis(0), "A1 reversed"),
    (SECOND, "A5 90 deg off", offset(4, -90), "+90 deg added to A5"),
    (SECOND, "points in metres", points(1e-3), "the measured points read as metres, not millimetres"),
    (SECOND, "columns x and y exchanged", point_columns(1, 0, 2), "the columns of the measured points read as y, x, z"),
    (SECOND, "columns of A2 and A3 exchanged", exchanged(1, 2), "the columns of A2 and A3 exchanged"),
    (SECOND, "A3 counted from the horizontal", counted_from_the_horizontal, "A2 subtracted from A3, which is counted from the horizontal"),
    (THIRD, "A4 counted the other way round", reversed_axis(3), "A4 reversed"),
    (THIRD, "y of the certified centres reversed", certified_mirrored, "y of the certified centres reversed"),
    (THIRD, "columns of the points x, z, y", point_columns(0, 2, 1), "the columns of the measured points read as x, z, y"),
    (THIRD, "A3 90 deg off", offset(2, -90), "+90 deg added to A3"),
)


def descriptions(given: argparse.Namespace) -> None:
    """Twenty wrong descriptions of three measured recordings: is the mistake named?

    A mistake is made in the arrays (angles, points, orientation, cell), then sought by ``mbcacq.description`` with its quick fit. It
    counts as named when the first change offered, or one said to fit as well, undoes it; a recording as it is must be left alone.
    Prints the page.
    """
    recordings = {name: load_observations(given.data / name) for name in (FIRST, SECOND, THIRD)}
    print(f"# Wrong descriptions\n\n    {CALL} > benchmarks/wrong_descriptions.md\n")
    print("| recording | mistake | found | named | s |\n|---|---|---|---|--:|")
    right = 0
    for name, what, mistake, undo in CASES:
        begin = time.process_time()
        found = wrong_descriptions(mistake(recordings[name]))
        seconds = time.process_time() - begin
        named = bool(found) and undo in (found[0].what, *found[0].alternatives)
        right += named
        print(f"| {name} | {what} | {'; '.join(map(str, found)) or 'nothing'} | {'yes' if named else 'no'} | {seconds:.1f} |", flush=True)
    clean = [name for name, o in recordings.items() if wrong_descriptions(o)]
    print(
        "\nPositions alone do not tell one mirror from another: a reversed coordinate and two exchanged columns of points or certificate "
        "differ by a rotation, which the pose of the station or the scanner absorbs. The right change is then among those said to fit as "
        "well."
    )
    print(f"\n{right} of {len(CASES)} named; of the {len(recordings)} recordings as they are, {len(clean)} were suspected.")


if __name__ == "__main__":
    ONLY = option("--only", choices=("ur5", "ur10"))
    bench.main(
        __doc__,
        {
            "transfer": (transfer, [DATA, poses(100_000), ONLY, writes("benchmarks/transfer.md")]),
            "compliance": (compliance, [DATA, poses(1500), writes("docs/data/ur10-tracker.md")]),
            "wrong-descriptions": (descriptions, [DATA]),
        },
    )
