"""Scans of parts as observations of a cell: at each pose the scanner sees the scene of a station, as a camera sees a board.

A scene is what its scans make of it, so its frame means nothing by itself: with the place of each station free, what counts is how the
scans stand to each other. Lengths are those of the scanner.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mbcacq.model.cell import SCENE, Artefact
from mbcacq.model.observations import Observations
from mbcacq.parts.scene import RegisteredScene

TARGET = 1  # number of a scene's origin, as of a ball


def observations_of_parts(obs: Observations, scenes: Mapping[str, tuple[RegisteredScene, np.ndarray]]) -> Observations:
    """The poses that saw parts, each with one measurement of its scene's pose, or none where its scan was left out.

    Parameters
    ----------
    obs
        The recording, in which poses of parts have no centres.
    scenes
        By the id of each station: its scene, and the index (N,) in ``obs`` of the pose of each of its scans.
    """
    ids = [s.id for s in obs.cell.stations if s.id in scenes]
    poses = np.concatenate([scenes[s][1] for s in ids])
    order, found = np.argsort(poses), [scenes[s][0] for s in ids]
    T, covariance = (np.concatenate(each)[order] for each in ([s.T_scanner_scene for s in found], [s.covariance for s in found]))
    # The errors that scans share are those of one scene.
    first, total = 0, sum(s.shared.shape[2] for s in found)
    shared = []
    for scene in found:
        columns = np.zeros((len(scene.T_scanner_scene), 6, total))
        columns[:, :, first : first + scene.shared.shape[2]] = scene.shared
        shared.append(columns)
        first += scene.shared.shape[2]
    target = Artefact(SCENE, "scanned part", (TARGET,), np.zeros((1, 3)), np.zeros(1), uncertainty_mm=0.0)
    stations = tuple(replace(obs.cell.station(s), artefact=target.id, T_base_station=None, sigma_mm=None) for s in ids)
    sigma = np.sqrt(np.median(np.einsum("nii->ni", covariance), axis=0))
    cell = replace(obs.cell, artefacts=(target,), stations=stations, noise_mm=sigma[:3], noise_rad=float(sigma[3:].mean()))
    number = {k: ids.index(s.id) for k, s in enumerate(obs.cell.stations) if s.id in ids}
    here = np.isin(obs.station, list(number))  # with scans that overlap with no other, which have no measurement
    kept = obs.select(here)
    station, pose = np.array([number[s] for s in kept.station.tolist()], dtype=int), (np.cumsum(here) - 1)[poses[order]]
    extra = {name: values for name, values in kept.extra.items() if name.startswith("poses.")}
    seen = replace(kept, cell=cell, station=station, pose=pose, ball=np.zeros(len(poses), dtype=int), extra=extra)
    shifts = np.concatenate(shared)[order] if total else None
    return replace(seen, xyz=T[:, :3, 3], rotation=T[:, :3, :3], covariance=covariance, shared=shifts, n_points=None, rms_mm=None)
