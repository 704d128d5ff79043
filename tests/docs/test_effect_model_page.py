"""The reference implementation of the documentation places the arm where the program does."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.effects.functions import DescribedPart, cosine, linear, of, sine, times
from mbcacq.effects.learnt_range import learnt_ranges
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.model.cell import RobotModel

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "effect-model.md"
DEG = np.pi / 180


def robot() -> RobotModel:
    chain = Chain(
        np.array([-1.0, 1, 1, -1, 1, -1]),
        np.array([0, 0, -90, 0, 0, 180]) * DEG,
        np.array([450.0, 0, 0, 660, 0, 80]),
        np.array([150.0, 610, 20, 0, 0, 0]),
        np.array([-90, 0, -90, 90, -90, 180]) * DEG,
        np.full(6, 1e-3),
    )
    com = np.array([[10.0, 0, 5], [-240, 0, 0], [0, 0, 120], [0, 200, 0], [0, 0, 0], [0, 0, -20]])
    limits = np.tile([-np.pi, np.pi], (6, 1))
    return RobotModel("arm", chain, limits, np.array([2.0, 38, 24, 9, 5, 0.5]), com, payload_mass=3.0, payload_com=np.array([-5.0, 3, 110]))


def result(postures: np.ndarray) -> dict:
    """A result whose effects are two of the catalogue and unmodelled groups of every kind, with random coefficients."""
    arm, rng = robot(), np.random.default_rng(2)
    model = EffectModel(arm)
    here = Covariates(model.poses(postures))

    def named(name: str, parts: list[DescribedPart], values: list[float]) -> EffectTerm:
        none = np.zeros(len(values))
        names = tuple(f"{name}[{j}]" for j in range(len(values)))
        ranges = learnt_ranges(here, parts)
        return EffectTerm(
            name=name,
            where=("A2",),
            depends_on="q2",
            parts=tuple(parts),
            names=names,
            units=("rad",) * len(values),
            coefficients=np.array(values),
            std=none,
            sigma=none + np.inf,
            typical=none,
            ranges=ranges,
        )

    soft = named("joint_compliance", [DescribedPart("joint", 1, 0, (linear("gravity_torque_2"),))], [4e-6])
    gear = named("gear_transmission_error", [DescribedPart("joint", 3, 0, (sine("q4", 12.5), cosine("q4", 12.5)))], [3e-4, -1e-4])
    play = named("backlash", [DescribedPart("joint", 2, 0, (of("gravity_torque_3", "tanh", 5.0),))], [2e-4])
    loose = named("mount_clearance", [DescribedPart("frame", 6, 4, (of("gravity_along_6_30_60", "sigmoid", 0.1, 0.2),))], [2e-4])
    wanted = [("A5", "q5"), ("link2", "q2"), ("base", "gravity_torque_2"), ("link3", "gravity_torque_4"), ("A3", "gravity_torque_3")]
    found = [unmodelled.group(here, at, on) for at, on in wanted]
    found.append(unmodelled.common_pattern(here, [0.3, 1.2, 2.0], [1, -1, 1], [0, 2, 4]))
    sags = [of("q2", "cosine", -1.5, 1.5, 3), times(of("q4", "sigmoid", 0.2, 0.3), of("q2", "distance", -0.1))]
    bump = named("unknown", [DescribedPart("frame", 3, 3, tuple(sags))], [2e-4, 1e-4])
    found.append(replace(bump, sigma=np.full(2, 1e-4), clamped=("q2", "q4")))
    slow = named("unknown", [DescribedPart("joint", 0, 0, (sine("q1", 1.0), cosine("q1", 2.0)))], [2e-4, 1e-4])
    found.append(replace(slow, sigma=np.full(2, 1e-4), clamped=("q1",)))
    grown = [replace(g, coefficients=g.sigma * rng.standard_normal(g.k)) for g in found if g is not None]
    errors = rng.normal(0, [1e-3, 0.3, 0.3, 1e-3, 1e-3], (6, 5))
    chains = {"nominal": arm.chain, "calibrated": arm.chain.with_errors(errors)}
    rows = {w: {p: getattr(c, p).tolist() for p in PARAMETERS} for w, c in chains.items()}
    rows["errors"] = {p: errors[:, i].tolist() for i, p in enumerate(PARAMETERS)}
    return {
        "format": "mbcacq-result/1",
        "method": "ml",
        "fit": {"poses": 40, "centres": 40, "rms_mm": 0.0, "chi2": 0.0, "dof": 1, "rank": 0},
        "robot": {"name": arm.name, "sign": arm.chain.sign.tolist(), "limits": arm.limits.tolist(), **rows},
        "T_flange_scanner": np.eye(4).tolist(),
        "preliminary": {"T_flange_scanner": np.eye(4).tolist()},
        "stations": [],
        "balls": [],
        "parameters": [],
        "names": [],
        "covariance": [],
        "noise": {"scanner_mm": [0.01] * 3, "joint_rad": [1e-5] * 6},
        "effects": replace(model, terms=(soft, gear, play, loose, *grown)).to_dict(),
    }


def test_the_page_computes_what_the_program_computes_within_a_nanometre():
    rng = np.random.default_rng(5)
    content = json.loads(json.dumps(result(rng.uniform(-1.0, 1.0, (40, 6)))))
    q = rng.uniform(-2.5, 2.5, (60, 6)) + 2 * np.pi * rng.integers(-1, 2, (60, 6))  # also outside of what was learnt, and turns further on
    page: dict = {}
    exec(re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1], page)  # noqa: S102
    cell = CalibratedCell.from_dict(content)
    ours = cell.frames(q)[:, -1]
    theirs = np.stack([page["flange"](content, row) for row in q])
    assert np.abs(cell.state.chain.flange(q) - ours)[:, :3, 3].max() > 0.1
    assert np.abs(theirs - ours)[:, :3, 3].max() < 1e-6
    assert np.abs(theirs - ours)[:, :3, :3].max() < 1e-9
