"""What was measured, as rows of the recording: float64 where a solver reads it."""

from __future__ import annotations

import numpy as np
import rerun as rr

from mbcacq.acquisition import events
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.checksums import digest_of_values
from mbcacq.recording.rrd.packed_cloud import packed
from mbcacq.recording.rrd.rows import named, row


def text_row(text: str) -> rr.DynamicArchetype:
    """What belongs to a TextDocument of this text."""
    return row(layout.TEXT_ARCHETYPE, **{layout.DIGEST: digest_of_values({"text": text})})


def scan_row(event: events.ScanTaken, *, pack: bool) -> rr.DynamicArchetype:
    """Everything of a scan; its points only where they are packed, else the same entity has them as Points3D."""
    scan = event.scan
    cloud = packed(scan) if pack else {"intensity": scan.intensity, "pixel": scan.pixel}
    return row(
        layout.SCAN_ARCHETYPE,
        pose=event.pose,
        exposure=event.exposure,
        **cloud,
        shape=scan.shape,
        time_s=float(scan.time_s),
        frame=scan.frame,
        exposure_us=float(scan.exposure_us),
        **named("measurements", scan.measurements),
    )


def sweep_row(event: events.SweepTaken, part: int) -> rr.DynamicArchetype:
    """The profiles of a sweep as they came, with the SHA-256 of all."""
    p = event.profiles
    values = {
        "pose": event.pose,
        "part": part,
        "ball": event.ball,
        "began_s": float(event.began_s),
        "expected": _float(event.expected),
        "counter": _int(p.counter),
        "time_s": _float(p.time_s),
        "encoder": _int(p.encoder),
        "inputs": _int(p.inputs),
        "first": _int(p.first),
        "points": np.asarray(p.points, dtype=np.float32),
        "lost": p.lost,
    }
    return row(layout.SWEEP_ARCHETYPE, **values, **{layout.DIGEST: digest_of_values(values)})


def exposure_row(event: events.CentresFound) -> rr.DynamicArchetype:
    """The balls of one exposure."""
    return row(
        layout.CENTRES_ARCHETYPE,
        pose=event.pose,
        exposure=event.exposure,
        ball=_int(event.ball),
        xyz=_float(event.xyz),
        n_points=_float(event.n_points),
        rms_mm=_float(event.rms_mm),
    )


def observation_rows(event: events.PoseDone, part: int, time_s: float) -> tuple[rr.DynamicArchetype, rr.DynamicArchetype]:
    """A finished pose and its balls, with the SHA-256 of both. time_s: since the run started, pauses between its parts included."""
    pose = {
        "pose": event.pose,
        "part": part,
        "station": event.station,
        "phase": event.phase,
        "step": event.step,
        "q": _float(event.q),
        "direction": _int(event.direction),
        "time_s": time_s,
        "robot_time_s": float(event.robot_time_s),
        "n_exposures": event.n_exposures,
        "current": None if event.current is None else _float(event.current),
        **named("sensors", event.sensors),
        **({"facts_names": list(event.facts), "facts_values": list(event.facts.values())} if event.facts else {}),
    }
    centres = {
        "ball": _int(event.ball),
        "xyz": _float(event.xyz),
        "n_points": _float(event.n_points),
        "rms_mm": _float(event.rms_mm),
        "scatter_mm": _float(event.scatter_mm),
    }
    digest = digest_of_values(pose | centres)
    return row(layout.POSE_ARCHETYPE, **pose, **{layout.DIGEST: digest}), row(layout.CENTRES_ARCHETYPE, **centres)


def _float(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.float64)


def _int(values: np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.int64)
