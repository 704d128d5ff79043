"""A synthetic diagnosis and devices of a run, for pages that need everything."""

import numpy as np

from mbcacq.diagnosis.effect_found import Alternative, EffectFound, MismatchEntry, ResponseShape
from mbcacq.diagnosis.motion.result import ChannelFit, ErrorBeforeAfter, FitOfMotion, MotionDiagnosis
from mbcacq.effects.effect import number
from mbcacq.model.channel_series import ChannelSeries, MotionSeries
from mbcacq.report.content import Devices


def diagnosis():
    return {
        "format": "mbcacq-diagnosis/1",
        "verdict": "explained",
        "mismatch": [
            {"at": "A2", "depends_on": "gravity_torque_2", "share": 0.6, "p_value": 1e-115},
            {"at": "link2", "depends_on": "time", "share": 0.001, "p_value": 1e-9},
        ],
        "effects": [
            {
                "name": "joint_compliance",
                "where": ["A2"],
                "depends_on": "gravity_torque_2",
                "p_value": 2e-190,
                "held_out_gain": 1.0,
                "parameters": {
                    "A2.compliance_rad_per_Nm": {"value": 2.094e-6, "std": 9.2e-8},
                    "A2.order": {"value": [1.0, 100.08], "std": [0.003, 0.021]},
                },
                "alternatives": [{"name": "joint_step", "where": ["A2"], "held_out_gain": 0.18}],
            }
        ],
        "fit": {
            "train": {"before_rms_mm": 0.0128, "after_rms_mm": 0.0092, "before_chi2_dof": 1.53, "after_chi2_dof": 1.0},
            "held_out": {
                "before_rms_mm": 0.0149,
                "after_rms_mm": 0.0097,
                "before_chi2_dof": 2.1,
                "after_chi2_dof": 1.03,
                "split": "station",
            },
            "repeatability_floor_mm": 0.01,
        },
        "not_separable": [],
        "advice": [],
        "dropped": {},
        "notes": ["exposure_latency was not considered: no velocities"],
    }


def pictures(poses=40, seed=0):
    rng = np.random.default_rng(seed)
    torque = np.sort(rng.uniform(0, 150, poses))
    turn = 2.094 * torque
    centres = {
        "pose": np.arange(poses).tolist(),
        "ball": [1] * poses,
        "point_mm": rng.uniform(-500, 500, (poses, 3)).tolist(),
        "before_mm": rng.normal(0, 0.02, (poses, 3)).tolist(),
        "after_mm": rng.normal(0, 0.005, (poses, 3)).tolist(),
        "of": poses,
    }
    curve = {
        "effect": "joint_compliance",
        "at": "A2",
        "what": "turn of A2",
        "unit": "µrad",
        "depends_on": "gravity_torque_2",
        "x_label": "gravity torque about A2",
        "x_unit": "N m",
        "x": torque.tolist(),
        "y": turn.tolist(),
        "std": (0.09 * torque).tolist(),
        "seen": (turn + rng.normal(0, 10, poses)).tolist(),
    }
    cause = {"name": "gravity_torque_2", "label": "gravity torque about A2", "unit": "N m", "values": torque.tolist()}
    spots = [
        {"at": at, "depends_on": on, "strength": float(rng.uniform(0, 400))}
        for at in ("A1", "A2", "base", "station12")
        for on in ("q1", "q2", "time")
    ]
    return {"format": "mbcacq-diagnosis-pictures/1", "map": spots, "centres": centres, "causes": [cause], "curves": [curve]}


def devices(seed=0):
    rng = np.random.default_rng(seed)
    late = np.zeros(5000)
    late[4000:] = 1
    return Devices(
        late=late,
        period_ms=4 + rng.gamma(1.0, 0.05, 4999),
        nominal_ms=4.0,
        exposure_s=rng.gamma(20, 0.05, 200),
        state_s=[("moving", 120.0), ("scanning", 300.0)],
        gaps=["pose 7 left out: 2 of 8 balls found"],
        health=[("scanner: temperature_C", "40", "45", "44")],
    )


def motion(seed=0):
    """A diagnosis with every kind of channel, a gap, a refused model and an unmodelled effect."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, 12, 0.004)
    channels, series = [], []
    for kind, unit, size, axes in (("tau", "N m", 900.0, 6), ("q_joint", "deg", 0.03, 3), ("q_set", "deg", 1.5, 6)):
        for k in range(axes):
            measured = size * (np.sin((0.4 + 0.1 * k) * time) + 0.05 * rng.normal(size=len(time)))
            before = np.where(np.abs(np.cos((0.4 + 0.1 * k) * time)) < 0.1, np.nan, 0.0)
            refused = (kind, k) == ("q_set", 4)
            after = before if refused else before + size * np.sin((0.4 + 0.1 * k) * time)
            series.append(ChannelSeries(kind, f"A{k + 1}", unit, 0, time, measured, before=before, after=after))
            error = ErrorBeforeAfter(0.7 * size, 0.05 * size, 6.54e6, 246.0)
            channels.append(ChannelFit(kind, f"A{k + 1}", unit, 1e-4 * size, error, error, 2.0 * size if refused else None))
    parameters = {"A2.coulomb_Nm": number(90.0, 8.0), "A2.viscous_Nms_per_rad": number(390.0, 17.0)}
    return MotionDiagnosis(
        verdict="partly_explained",
        mismatch=(MismatchEntry("A2", "qd2", 0.8, 1e-90, channel="tau"), MismatchEntry("q_joint", "qd", 0.001, 1e-9, channel="q_joint")),
        effects=(
            EffectFound(
                name="friction",
                where=("A2",),
                depends_on="qd2",
                parameters=parameters,
                p_value=1e-90,
                held_out_gain=0.8,
                alternatives=(Alternative("backlash", ("A2",), 0.1, 1e-3),),
                channel="tau",
                held_out_gain_here=0.9,
                steps=(),
            ),
            EffectFound(
                name="unknown",
                where=("A4",),
                depends_on="q4",
                parameters={},
                p_value=1e-9,
                held_out_gain=0.1,
                channel="q_set",
                shape=ResponseShape((0.0, 1.0), (0.01, -0.01)),
            ),
        ),
        fit=FitOfMotion.of(channels, "time block"),
        suspicions=("with a load that differs by 130 kg the torque is explained better",),
        plot_data=MotionSeries("an arm of six axes", ("recordings/of-an-arm/with-a-long-name",), tuple(series)),
    )
