"""Time and memory of a calibration, beside SciPy, pybotics and FIGAROH."""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench import HERE, machine
from cells import measure, scanner_cell, tracker_cell

from mbcacq.calibration.calibrate import calibrate
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState, predict
from mbcacq.estimation.initial_guess import start
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.parameters import Estimate
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import system
from mbcacq.estimation.solver import solve
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.observations import Observations

PEER_POSES, PEER_EVALUATIONS = 120, 8
TRACKER_POSES = 104
MADE_POSES = 1000  # of which larger recordings are repetitions, at stations of their own and with noise of their own
NOISE = Noise(np.array([0.005, 0.005, 0.009]), np.full(6, 8e-6))


def best(function: Callable[[], object], repeats: int) -> float:
    """Smallest processor time in ms: what else the machine does counts little in it."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
    return 1e3 * min(times)


def peer(lineariser: Lineariser, begin: Estimate, weights: Weights, sparse: bool) -> float:
    """One run of scipy.optimize.least_squares to its own end; returns its final cost (chi square).

    sparse: by trf with the sparsity pattern of the Jacobian, stopped after PEER_EVALUATIONS; else by MINPACK's dense Levenberg-Marquardt.
    """
    from scipy.optimize import least_squares
    from scipy.sparse import lil_matrix

    layout, rows = lineariser.layout, lineariser.rows
    g, s = layout.size, len(rows.stations)
    at = system(lineariser, begin, NOISE, weights)
    count = at.X.shape[1]

    def residual(x: np.ndarray) -> np.ndarray:
        moved = begin.moved(layout, x[:g], x[g:].reshape(s, 6))
        return at.whitening(lineariser.evaluate(moved).rows[..., None]).reshape(-1)

    first = np.zeros(g + 6 * s)
    scale = np.concatenate([layout.scale * 0.01, np.tile([0.1, 0.1, 0.1, 1e-3, 1e-3, 1e-3], s)])
    if not sparse:
        return 2 * float(least_squares(residual, first, x_scale=scale, method="lm").cost)
    pattern = lil_matrix((len(residual(first)), g + 6 * s), dtype=int)
    pattern[:, :g] = 1
    for p, run in enumerate(rows.run):
        pattern[p * count : (p + 1) * count, g + 6 * run : g + 6 * run + 6] = 1
    found = least_squares(residual, first, jac_sparsity=pattern, x_scale=scale, method="trf", max_nfev=PEER_EVALUATIONS)
    return 2 * float(found.cost)


def recording(poses: int) -> Observations:
    """Observations of an arm with errors, eight balls a pose and eight poses a station."""
    rng = np.random.default_rng(0)
    times = max(poses // MADE_POSES, 1)
    made = scanner_cell(rng, stations=poses // times // 8)
    if times == 1:
        return made.observations
    one, count = made.observations, len(made.observations.cell.stations)
    stations = tuple(replace(s, id=f"{k}-{s.id}") for k in range(times) for s in one.cell.stations)
    truth = replace(made.truth, T_base_station=np.tile(made.truth.T_base_station, (times, 1, 1)))
    many = Observations(
        replace(one.cell, stations=stations),
        np.arange(times * one.n_poses),
        np.concatenate([one.station + k * count for k in range(times)]),
        np.tile(one.q, (times, 1)),
        np.concatenate([one.pose + k * one.n_poses for k in range(times)]),
        np.tile(one.ball, times),
        np.tile(one.xyz, (times, 1)),
    )
    return measure(many, truth, rng, NOISE.point, NOISE.joint[0])


def reflector() -> tuple[Observations, Chain, CellState]:
    """Readings of a reflector on the flange by a tracker, the nominal arm and the truth. The arm has no errors that pybotics has no
    parameter for (beta)."""
    rng = np.random.default_rng(0)
    cell = tracker_cell(rng, TRACKER_POSES)
    nominal, errors = cell.observations.cell.robot.chain, cell.errors * [1, 1, 1, 1, 0]
    truth = replace(cell.truth, chain=nominal.with_errors(errors))
    xyz = predict(cell.observations, truth).xyz + rng.normal(size=(TRACKER_POSES, 3)) * 0.02
    return replace(cell.observations, xyz=xyz), nominal, truth


def pybotics(interpreter: str) -> str:
    """Its fit of an arm to the readings, from the nominal arm. It is given the place of the base to a few millimetres and of the tool."""
    obs, nominal, truth = reflector()
    links = np.column_stack([np.r_[0.0, nominal.alpha[:-1]], np.r_[0.0, nominal.a[:-1]], nominal.theta, nominal.d])
    free = np.ones(links.shape, bool)
    free[0], free[1, 3] = False, False  # the base's own place; d of the first of two parallel axes
    end = np.eye(4)
    end[:3, :3] = se3.rotation_exp(np.array([nominal.alpha[-1], 0.0, 0.0]))
    tool = end @ np.r_[truth.T_flange_scanner[:3, 3], 1.0]
    base = se3.inverse(truth.T_base_station[0])
    world = np.r_[base[:3, 3] + [3.0, -2.0, 4.0], _zyx(base[:3, :3])]
    given = {"links": links, "free": free, "tool": np.r_[tool[:3], 0, 0, 0], "world": world}
    found = _fit_by(interpreter, "pybotics", q=obs.q * nominal.sign, xyz=obs.xyz, **given)
    return f"pybotics: {_said(found)}"


def figaroh(interpreter: str) -> str:
    """Its fits of the arm to the same readings, from the nominal arm and its own guess of the base and the tool."""
    obs, nominal, _ = reflector()
    turn = se3.exp(np.concatenate([np.zeros((nominal.n, 5)), nominal.theta[:, None]], axis=1))
    links = replace(nominal, theta=np.zeros(nominal.n)).link_transforms(np.zeros((1, nominal.n)))[0]
    placements = np.concatenate([turn[:1], links[:-1] @ turn[1:], links[-1:]])
    found = _fit_by(interpreter, "figaroh", q=obs.q * nominal.sign, xyz=obs.xyz, placements=placements)
    return "; ".join(f"FIGAROH, {method}, {one['parameters']} parameters: {_said(one)}" for method, one in found.items())


def _fit_by(interpreter: str, peer: str, **given: np.ndarray) -> dict:
    """What ``peer_fits.py`` prints of these arrays."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.npz"
        np.savez(file, **given)
        command = [interpreter, str(HERE / "peer_fits.py"), peer, str(file)]
        return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def _said(found: dict) -> str:
    return f"{1e3 * found['seconds']:.0f} ms, rms {found['rms_mm']:.4f} mm after {found['evaluations']} evaluations"


def _zyx(R: np.ndarray) -> list[float]:
    """The three angles by which pybotics writes a rotation: R = Rz(a) Ry(b) Rx(c)."""
    return [float(np.arctan2(R[1, 0], R[0, 0])), float(-np.arcsin(R[2, 0])), float(np.arctan2(R[2, 1], R[2, 2]))]


def calibration(given: argparse.Namespace) -> None:
    """Time to calibrate, against the number of poses, and beside scipy's sparse least squares on the same problem from the same start.

    Prints a Markdown table. The peer gets everything for nothing: start, noise, and the true sparsity pattern of its Jacobian (arm and
    hand-eye dense, each station's six columns only where it is seen). It minimises the same whitened residuals with numerical derivatives.
    --pybotics, --figaroh: they fit the arm to 104 readings of a reflector by a tracker, and so does ``calibrate``.
    """
    print(f"<!-- {machine()} -->")
    print("| poses | stations | calibrate ms | adjustment alone ms | scipy ms, sparse and dense | scipy over calibrate | peak memory MB |")
    print("|--:|--:|--:|--:|--:|--:|--:|")
    for poses in given.poses:
        obs = recording(poses)
        repeats = max(min(given.repeats, 30000 // poses), 3)
        whole = best(lambda obs=obs: calibrate(obs), repeats)
        options = CalibrationOptions(balls=False)
        lineariser = Lineariser(obs, parameters.build(obs, options), options)
        begin, weights = Estimate(start(obs)), lineariser.everything
        alone = best(lambda a=lineariser, b=begin, w=weights: solve(system(a, b, NOISE, w)), repeats)
        other = ratio = "-"
        if not given.no_peer and poses <= PEER_POSES:
            ours = solve(system(lineariser, begin, NOISE, weights)).cost
            scipy_ms = []
            for sparse in (True, False):
                clock = time.process_time()
                theirs = peer(lineariser, begin, weights, sparse)
                scipy_ms.append(1e3 * (time.process_time() - clock))
                print(f"<!-- {poses} poses: scipy ended at chi square {theirs:.1f}, we at {ours:.1f} -->")
            other, ratio = (", ".join(f"{one:.0f}" for one in each) for each in (scipy_ms, np.array(scipy_ms) / whole))
        tracemalloc.start()
        calibrate(obs)
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        print(f"| {poses} | {len(obs.cell.stations)} | {whole:.0f} | {alone:.0f} | {other} | {ratio} | {peak:.0f} |", flush=True)
    if given.pybotics or given.figaroh:
        obs = reflector()[0]
        own = best(lambda: calibrate(obs), given.repeats)
        print(f"{TRACKER_POSES} readings of a reflector: calibrate {own:.0f} ms, rms {calibrate(obs).fit.rms_mm:.4f} mm")
    if given.pybotics:
        print(pybotics(given.pybotics))
    if given.figaroh:
        print(figaroh(given.figaroh))
