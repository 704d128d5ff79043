"""What is not known, held apart from noise: hand-eye alone, arms that err beyond their geometry, recordings of real arms.

    python benchmarks/error_model.py [--arms 200] [--seeds 100] [--links 60] [--serial 40] [--cells 12] [--data FOLDER ..]

Hand-eye: arms of three classes (KR 10 with 0.15 mm and 0.03 deg, iiwa 7 with the same, KR 10 with three times as much), one and four
places. The normalised error squared (NEES) is d' inv(C) d / 6 of the hand-eye transform. Links: ordinary arms in few poses, judged all
over the workspace. Serial: the same, whose errors the poses after one another share. Arms: the errors are written here as plain formulas
and applied to the joints; judged at new places, without noise of the judging, a rigid motion of everything aside. Data: observation
sets, each in five blocks of the order of measuring.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import bench  # noqa: F401  # the simulated cells of the tests
import numpy as np
from cells import Simulated, iiwa, kr10, scanner_cell
from erring_arms import JOINT, LAWS, NOISE, erring_arm, placed_wrong
from mbcacq_fakes.cell import computed_run

from mbcacq import load_observations
from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.held_out_poses import about_best_station, held_out_masks, prediction_error
from mbcacq.errors import MbcacqError
from mbcacq.estimation import forward_model, parameters
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise, select_phases
from mbcacq.estimation.parameters import Estimate
from mbcacq.estimation.solution import system
from mbcacq.estimation.solver import solve
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations
from mbcacq.plan import expand, load
from mbcacq.workflow.acquire import solver_cell

ALONE = CalibrationOptions(kinematics=False)
TWIST = ("x", "y", "z", "rx", "ry", "rz")


def ordinary_errors(chain, rng, mm=0.15, deg=0.03):
    errors = rng.normal(size=(chain.n, 5)) * np.array([np.radians(deg), mm, mm, np.radians(deg), np.radians(deg)])
    parallel = chain.parallel_next()
    errors[parallel, 1], errors[~parallel, 4], errors[-1] = 0, 0, 0
    errors[0, :2] = 0
    return errors


def hand_eye_error(found, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twist (6,) mm and rad between a calibrated hand-eye and the true one, and its stated covariance (6, 6)."""
    off = se3.inverse(found.state.T_flange_scanner) @ true
    index = [found.names.index(f"hand_eye.{c}") for c in TWIST]
    return np.concatenate([off[:3, 3], se3.rotation_log(off[:3, :3])]), found.covariance[np.ix_(index, index)]


def hand_eye_bound(cell: Simulated, link_mm: float, link_deg: float) -> np.ndarray:
    """(6,) mm and rad: the least standard deviations with which these poses determine the hand-eye twist.

    Cramer-Rao, with links of known sizes and joints of known repeatability integrated out and the places free; every derivative is a
    difference of two predictions.
    """
    obs, truth = cell.observations, cell.truth
    q = range(obs.cell.robot.n)

    def slope(change, h: float) -> np.ndarray:
        low, high = (forward_model.predict(obs, *change(sign * h)).xyz for sign in (-1, 1))
        return (high - low) / (2 * h)

    def unit(k: int, count: int, h: float) -> np.ndarray:
        return h * np.eye(count)[k]

    def mounted(k: int):
        return lambda h: (replace(truth, T_flange_scanner=truth.T_flange_scanner @ se3.exp(unit(k, 6, h))),)

    def placed(s: int, k: int):
        def change(h: float):
            places = truth.T_base_station.copy()
            places[s] = places[s] @ se3.exp(unit(k, 6, h))
            return (replace(truth, T_base_station=places),)

        return change

    def bent(j: int, p: int):
        def change(h: float):
            errors = cell.errors.copy()
            errors[j, p] += h
            return (replace(truth, chain=obs.cell.robot.chain.with_errors(errors)),)

        return change

    def turned(j: int):
        return lambda h: (truth, forward_model.Displacements(joint=np.tile(unit(j, len(q), h), (obs.n_poses, 1))))

    steps = (1e-3, 1e-3, 1e-3, 1e-6, 1e-6, 1e-6)
    links = [(j, p) for j, p in np.ndindex(cell.errors.shape) if cell.errors[j, p]]
    size = np.array([np.radians(link_deg), link_mm, link_mm, np.radians(link_deg), np.radians(link_deg)])
    X = np.stack(
        [slope(mounted(k), steps[k]) for k in range(6)]
        + [slope(placed(s, k), steps[k]) for s in range(len(truth.T_base_station)) for k in range(6)]
        + [slope(bent(j, p), 1e-3 * size[p]) for j, p in links],
        axis=2,
    )
    J = np.stack([slope(turned(j), 1e-6) for j in q], axis=2) * JOINT
    information = np.zeros((X.shape[2], X.shape[2]))
    information[np.diag_indices(X.shape[2])] += np.concatenate([np.zeros(X.shape[2] - len(links)), [size[p] ** -2.0 for _, p in links]])
    for pose in range(obs.n_poses):
        rows = obs.pose == pose
        x, j = X[rows].reshape(-1, X.shape[2]), J[rows].reshape(-1, len(q))
        noise = np.diag(np.tile(np.square(NOISE), int(rows.sum()))) + j @ j.T
        information += x.T @ np.linalg.solve(noise, x)
    scale = 1 / np.sqrt(np.diag(information))
    return np.sqrt(np.diag(scale[:, None] * np.linalg.inv(scale[:, None] * information * scale) * scale)[:6])


def hand_eye(arms: int) -> None:
    print(
        "| arm | places, poses | NEES / 6 | error over the bound, rms | beyond 3 sigma | rms x y z, um | poses rejected | warned of |\n"
        "|---|---|---|---|---|---|---|---|"
    )
    for name, make, scale in (("KR 10", kr10, 1.0), ("iiwa 7", iiwa, 1.0), ("KR 10, three times the errors", kr10, 3.0)):
        for places, poses in ((1, 10), (1, 40), (4, 60)):
            rows, rejected, warned, seen = [], 0, 0, 0
            for seed in range(arms):
                rng, chain = np.random.default_rng([seed, places, poses]), make()
                errors = ordinary_errors(chain, rng, 0.15 * scale, 0.03 * scale)
                try:
                    cell = scanner_cell(rng, chain=chain, stations=places, per_station=poses // places, errors=errors)
                except AssertionError:
                    continue  # a place that this arm cannot look at from all sides
                found = calibrate(cell.observations, ALONE)
                d, C = hand_eye_error(found, cell.truth.T_flange_scanner)
                least = hand_eye_bound(cell, 0.15 * scale, 0.03 * scale)
                rows.append(np.concatenate([d, d / np.sqrt(np.diag(C)), [d @ np.linalg.solve(C, d) / 6], d / least]))
                rejected, seen = rejected + len(found.fit.rejected), seen + cell.observations.n_poses
                warned += "warnings" in found.extra
            table = np.array(rows)
            size = ", ".join(f"{1e3 * s:.1f}" for s in np.sqrt(np.mean(table[:, :3] ** 2, axis=0)))
            print(
                f"| {name} | {places}, {poses} | {table[:, 12].mean():.2f} | {np.sqrt(np.mean(table[:, 13:] ** 2)):.2f} "
                f"| {np.mean(np.abs(table[:, 6:12]) > 3):.1%} | {size} "
                f"| {rejected / seen:.2%} | {warned / len(rows):.1%} |",
                flush=True,
            )


def measurable_hand_eye(chain, truth) -> np.ndarray:
    """T_flange_scanner of a fake cell behind the nominal last link: what the true last link adds is part of it for every calibration."""
    still = np.zeros((1, chain.n))
    nominal, true = (se3.inverse(c.frames(still)[0, -2]) @ c.frames(still)[0, -1] for c in (chain, chain.with_errors(truth["errors"])))
    return se3.inverse(nominal) @ true @ truth["T_flange_scanner"]


def shipped_plan(name: str, seeds: int) -> None:
    """The fake cell of a plan, hand-eye alone: its arm has the link errors that the paper found."""
    loaded = load(f"plans/{name}.yaml")
    poses, z = expand(loaded), []
    for seed in range(seeds):
        got = computed_run.observe(loaded.cell, poses, [], seed)
        numbers, phase = np.array([p.number for p in poses]), np.array([p.phase for p in poses])
        obs = Observations(solver_cell(loaded), numbers, got.station, got.q, got.pose, got.ball, got.xyz, phase=phase)
        found = calibrate(obs, ALONE)
        d, C = hand_eye_error(found, measurable_hand_eye(loaded.cell.robot.chain, got.truth))
        z.append(d / np.sqrt(np.diag(C)))
    size = np.abs(z)
    print(f"plans/{name}.yaml, {seeds} seeds: {np.mean(size <= 3):.1%} of the six within 3 sigma, at most {size.max():.1f}", flush=True)


def arms(cells: int) -> None:
    print("| arm | without smooth errors, um | calibrate, um | residual, um | groups | time over that without |\n|---|---|---|---|---|---|")
    for name, law in LAWS.items():
        rows = []
        for seed in range(cells):
            learn, new, truth = erring_arm(law, seed)
            begin = time.process_time()
            alone = calibrate(learn, CalibrationOptions(discrepancy=False))
            between = time.process_time()
            found = calibrate(learn)
            taken = (time.process_time() - between) / (between - begin)
            groups = len(found.effects.terms) if found.effects else 0
            rows.append((placed_wrong(alone, new, truth), placed_wrong(found, new, truth), 1e3 * found.fit.rms_mm, groups, taken))
        m = np.mean(rows, axis=0)
        print(f"| {name} | {m[0]:.0f} | {m[1]:.0f} | {m[2]:.1f} | {m[3]:.1f} | {m[4]:.1f} |", flush=True)


def workspace_errors(found, truth, postures: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Errors (K,) mm of the coordinates of points all over the workspace, a rigid motion of everything aside; and their stated sigma."""
    obs, rng = found.fit.observations, np.random.default_rng(5)
    low, high = found.state.chain.drawn_between(obs.cell.robot.limits)
    q = rng.uniform(low, high, size=(postures, obs.cell.robot.n))
    xyz = np.tile(obs.xyz.mean(axis=0), (postures, 1))
    points = found.placed(q, xyz)
    off = points - se3.apply(truth.chain.frames(q)[:, -1] @ truth.T_flange_scanner, xyz)
    rigid = np.concatenate([np.tile(np.eye(3), (postures, 1, 1)), -1e-3 * se3.skew(points)], axis=2).reshape(-1, 6)
    rest = np.eye(3 * postures) - rigid @ np.linalg.pinv(rigid)
    A = rest @ found.point_columns(q, xyz).reshape(3 * postures, -1)
    return rest @ off.ravel(), np.sqrt(np.einsum("kg,gh,kh->k", A, found.covariance, A))


def links(arms: int) -> None:
    """Ordinary arms in few poses: the nominal arm, links free, and links of a common size."""
    print("| poses | joints repeat within | nominal, um | free links, um | calibrate, um | median | within 2 sigma: free | calibrate |")
    print("|---|---|---|---|---|---|---|---|")
    methods = (
        CalibrationOptions(kinematics=False, refuse=False),
        CalibrationOptions(discrepancy=False, random_links=False, refuse=False),
        CalibrationOptions(refuse=False),
    )
    for places, each in ((5, 5), (8, 8), (16, 12)):
        for joint in (8e-6, 8e-5, 4e-4):
            size, within = np.zeros((arms, 3)), np.zeros((arms, 3))
            for seed in range(arms):
                rng = np.random.default_rng([11, seed, places])
                errors = ordinary_errors(kr10(), rng)
                cell = scanner_cell(rng, stations=places, per_station=each, errors=errors, joint_rad=joint)
                for k, method in enumerate(methods):
                    off, sigma = workspace_errors(calibrate(cell.observations, method), cell.truth)
                    size[seed, k], within[seed, k] = np.sqrt(3 * np.mean(off**2)), np.mean(np.abs(off) < 2 * sigma)
            rms, share = 1e3 * np.sqrt(np.mean(size**2, axis=0)), within.mean(axis=0)
            middle = 1e3 * np.median(size, axis=0)
            print(
                f"| {places * each} | {1e6 * joint:.0f} urad | {rms[0]:.0f} | {rms[1]:.0f} | {rms[2]:.0f} "
                f"| {middle[1]:.0f} / {middle[2]:.0f} | {share[1]:.1%} | {share[2]:.1%} |",
                flush=True,
            )


def serial(arms: int) -> None:
    """Ordinary arms with joint errors of correlation 0.95 from one pose to the next: geometry alone, and calibrate."""
    print("| places x poses | joints err by | geometry alone, um | calibrate, um | mean square over sigma | within 2 sigma | wander |")
    print("|---|---|---|---|---|---|---|")
    methods = (CalibrationOptions(discrepancy=False, refuse=False), CalibrationOptions(refuse=False))
    for places, each in ((8, 8), (4, 24)):
        for joint in (8e-6, 3e-5, 8e-5):
            size, square, within, found = np.zeros((arms, 2)), np.zeros((arms, 2)), np.zeros((arms, 2)), 0
            for seed in range(arms):
                rng = np.random.default_rng([78, seed, places])
                cell = scanner_cell(rng, stations=places, per_station=each, errors=ordinary_errors(kr10(), rng))
                obs, off = cell.observations, rng.normal(size=cell.observations.q.shape)
                for p in range(1, len(off)):
                    off[p] = 0.95 * off[p - 1] + np.sqrt(1 - 0.95**2) * off[p]
                xyz = forward_model.predict(obs, cell.truth, forward_model.Displacements(joint=joint * off)).xyz
                obs = replace(obs, xyz=xyz + rng.normal(size=xyz.shape) * obs.cell.noise_mm)
                fits = [calibrate(obs, method) for method in methods]
                for k, fit in enumerate(fits):
                    wrong, sigma = workspace_errors(fit, cell.truth)
                    size[seed, k], square[seed, k] = np.sqrt(3 * np.mean(wrong**2)), np.mean((wrong / sigma) ** 2)
                    within[seed, k] = np.mean(np.abs(wrong) < 2 * sigma)
                found += "wander_rad" in fits[-1].extra.get("discrepancy", {})
            rms, mean, share = 1e3 * np.sqrt(np.mean(size**2, axis=0)), square.mean(axis=0), within.mean(axis=0)
            print(
                f"| {places} x {each} | {1e6 * joint:.0f} urad | {rms[0]:.0f} | {rms[1]:.0f} | {mean[0]:.2f}, {mean[1]:.2f} "
                f"| {share[0]:.1%}, {share[1]:.1%} | {found} of {arms} |",
                flush=True,
            )


def least_squares(obs):
    """The geometry by plain least squares of the centres, every one of the same weight."""
    first = calibrate(obs, CalibrationOptions(discrepancy=False, refuse=False))
    options = CalibrationOptions(discrepancy=False, refuse=False, balls=False)
    layout = parameters.build(obs, options)
    for name, why in first.layout.held.items():
        layout = layout if name in layout.held else layout.hold(name, why)
    noise = Noise(np.ones(3), np.full(obs.cell.robot.n, 1e-9), 1e-3)
    lineariser = Lineariser(obs, layout, options)
    return solve(system(lineariser, Estimate(first.state), noise, lineariser.everything)).estimate.state


METHODS = {
    "nominal": lambda o: calibrate(o, CalibrationOptions(kinematics=False, discrepancy=False, refuse=False)),
    "least squares": least_squares,
    "geometry alone": lambda o: calibrate(o, CalibrationOptions(discrepancy=False, random_links=False, refuse=False)),
    "calibrate": lambda o: calibrate(o, CalibrationOptions(refuse=False)),
}


def parts(obs: Observations) -> tuple[list[np.ndarray], bool]:
    """Five parts, and whether they are whole stations: five groups of these where there are so many, else blocks of the order."""
    stations = np.unique(obs.station)
    if len(stations) < 5:
        return held_out_masks(obs, "block", None, 5, 0), False
    return [np.isin(obs.station, some) for some in np.array_split(stations, 5)], True


def recordings(folders: list[Path], most: int) -> None:
    """Five parts, each predicted by the others; 3D rms mm over all, and of the worst part. The place of a station left out is fitted."""
    print(f"| recording | poses | {' | '.join(METHODS)} |\n|---|---|{'---|' * len(METHODS)}")
    for folder in folders:
        obs = select_phases(load_observations(folder), CalibrationOptions())
        keep = np.zeros(obs.n_poses, bool)
        keep[np.unique(np.linspace(0, obs.n_poses - 1, most).astype(int))] = True
        obs = obs.select(keep)
        masks, whole = parts(obs)
        cells = []
        for method in METHODS.values():
            try:
                squares = []
                for test in masks:
                    held, found = obs.select(test), method(obs.select(~test))
                    off = about_best_station(held, found)[0] if whole else prediction_error(held, found)
                    squares.append(np.mean(off**2))
                cells.append(f"{np.sqrt(np.mean(squares)):.3f} ({np.sqrt(max(squares)):.3f})")
            except MbcacqError as error:
                cells.append(str(error)[:40])
        print(f"| {folder.name} | {obs.n_poses} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--links", type=int, default=60)
    parser.add_argument("--serial", type=int, default=40)
    parser.add_argument("--cells", type=int, default=12)
    parser.add_argument("--data", type=Path, nargs="*", default=[])
    parser.add_argument("--poses", type=int, default=300, help="of each recording, at most")
    given = parser.parse_args()
    if given.arms:
        hand_eye(given.arms)
    if given.seeds:
        shipped_plan("quick", given.seeds)
    if given.links:
        links(given.links)
    if given.serial:
        serial(given.serial)
    if given.cells:
        arms(given.cells)
    recordings(given.data, given.poses)


if __name__ == "__main__":
    main()
