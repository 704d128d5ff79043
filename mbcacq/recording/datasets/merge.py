"""Two logs of one motion, the arm's and an instrument's, each with a clock of its own, as one table with a row for each standstill.

The delay between the clocks is where the speeds of both agree best. Times that arrive in bursts are made even first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.clock import in_seconds
from mbcacq.files.table import Table, TableSchema, read_table
from mbcacq.quantities import DEGREE
from mbcacq.recording.datasets.columns import flange_group, groups, joint_angles, joint_columns, unit_above
from mbcacq.recording.datasets.csv_columns import TIME, numbers
from mbcacq.recording.datasets.pose_columns import LENGTHS, RTDE_POSE, PoseHeadings, heading, role

LOG = TableSchema("a log", (TIME,), preamble=True)
LEAST_ROWS = 20
LONGEST_STEP_S = 60.0  # between the rows of a log of a motion
MOST_STEPS = 400_000  # of the grid on which speeds are compared
BURST_STEP, BURST_SHARE = 0.1, 0.3  # steps below a tenth of the mean; share of them from which times count as bursts
LEAST_CORRELATION = 0.6  # of the speeds; two unrelated motions reach 0.3
OTHER_PEAK = 0.9  # of the best correlation: from there on another delay is as likely
DISTINCT_S = 1.0  # delays closer than this are one peak
CREEP = 3.0  # times that range over a whole standstill: the arm moves slowly
STILL = {"joints": 0.02 * DEGREE, "flange": 0.1}  # rad, mm: range within which an arm stands still; encoders are noisier than 0


@dataclass(frozen=True)
class RestRule:
    """seconds: shortest that counts; settle_s: left out at its begin, while the arm swings."""

    seconds: float = 0.5
    settle_s: float = 0.2


@dataclass(frozen=True)
class MergedLogs:
    """table: a row for each standstill, columns of the arm and of the target; sentences: how the clocks were understood."""

    table: Table
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class _Log:
    """A log with its time_s (T,), rising, and what moves (T, k): rad of joints, or mm."""

    table: Table
    time_s: np.ndarray
    value: np.ndarray
    kind: str


@dataclass(frozen=True)
class ClockDelay:
    """Time of the instrument's clock at time t of the arm's: at_s + t + rate * (t - middle_s). correlation: of the speeds."""

    at_s: float
    rate: float
    middle_s: float
    correlation: float

    def of_instrument(self, t: np.ndarray) -> np.ndarray:
        return self.at_s + t + self.rate * (t - self.middle_s)


def merge_logs(arm: Path, measured: Path, columns: Mapping[str, str], still: RestRule | None = None) -> MergedLogs:
    """Merge the log of an arm (joint angles or poses of the flange) and that of an instrument (points or poses of a target).

    columns: names of this program -> names in the files. Raises ConfigError if a log has no times, the speeds agree at no delay or at
    several, or the arm never stands still.
    """
    still = still or RestRule()
    names = {file: ours for ours, file in columns.items()}
    first, second = (_read(path, names) for path in (arm, measured))
    hand, moving = _arm(first)
    if hand is not None and hand.length is None and (unit := unit_above(first)):
        hand = replace(hand, length=LENGTHS[unit])
    seen = _target(second)
    if seen.length is None and (unit := unit_above(second)):
        seen = replace(seen, length=LENGTHS[unit])
    log_a, said_a = _log(first, moving, hand is None)
    log_b, said_b = _log(second, second.numbers(seen.translation) * (seen.with_units(second).length or 1.0), False)
    delay = clock_delay(log_a.time_s, log_a.value, log_b.time_s, log_b.value, str(measured))
    stands = standstills(log_a.time_s, log_a.value, STILL[log_a.kind], still)
    if not stands:
        raise ConfigError(
            f"{arm}: the arm never stands still for {still.seconds:g} s; let it rest at each pose, or say a shorter --standstill"
        )
    table, used = _table(log_a, log_b, hand, seen, delay, stands)
    if not used:
        raise ConfigError(f"{measured}: nothing was measured while the arm stood still; check that both logs are of one motion")
    ppm = f" and runs {1e6 * delay.rate:+.0f} ppm" if delay.rate else ""
    sentences = (
        *said_a,
        *said_b,
        f"the instrument's clock is {delay.at_s:+.4f} s from the arm's{ppm} (speeds agree with a correlation of {delay.correlation:.2f})",
        f"{len(stands)} standstills of {still.seconds:g} s and more, {used} of them with measurements",
    )
    return MergedLogs(table, sentences)


def clock_delay(t_a: np.ndarray, a: np.ndarray, t_b: np.ndarray, b: np.ndarray, source: str = "the log") -> ClockDelay:
    """Delay of the clock of b (M, k) at t_b (M,) s behind that of a (N, j) at t_a (N,) s, by the correlation of their speeds.

    Raises ConfigError if they agree at no delay, or at another one as well.
    """
    step = max(float(np.median(np.diff(t_a))), float(np.median(np.diff(t_b))), (np.ptp(t_a) + np.ptp(t_b)) / MOST_STEPS)
    lags, found = _correlation(_speed(t_a, a, step), _speed(t_b, b, step))
    best = int(np.argmax(found))
    if found[best] < LEAST_CORRELATION:
        raise ConfigError(
            f"{source}: its motion agrees with the arm's at no delay (correlation {found[best]:.2f} at best); are both logs of one motion, "
            "and do they overlap in time?"
        )
    others = found[np.abs(lags - lags[best]) * step > DISTINCT_S]
    if others.size and others.max() > OTHER_PEAK * found[best]:
        other = lags[np.abs(lags - lags[best]) * step > DISTINCT_S][int(np.argmax(others))]
        raise ConfigError(
            f"{source}: its motion agrees with the arm's at a delay of {lags[best] * step:.2f} s and of {other * step:.2f} s alike; "
            "move the arm less regularly, or cut the logs to one pass"
        )
    lag = (lags[best] + _vertex(found, best)) * step
    offset = float(t_b[0] - t_a[0] + lag)
    middle = float(np.mean([max(t_a[0], t_b[0] - offset), min(t_a[-1], t_b[-1] - offset)]))
    rate = _rate(t_a, a, t_b - offset, b, step, middle)
    return ClockDelay(offset, rate, middle, float(found[best]))


def _rate(t_a: np.ndarray, a: np.ndarray, t_b: np.ndarray, b: np.ndarray, step: float, middle: float) -> float:
    """By how much the second clock runs faster, from the delays of both halves; 0 where they do not differ by more than a step."""
    delays = []
    for half in (-1, 1):
        keep_a, keep_b = half * (t_a - middle) >= 0, half * (t_b - middle) >= -DISTINCT_S
        if min(keep_a.sum(), keep_b.sum()) < LEAST_ROWS:
            return 0.0
        lags, found = _correlation(_speed(t_a[keep_a], a[keep_a], step), _speed(t_b[keep_b], b[keep_b], step))
        offset = t_b[keep_b][0] - t_a[keep_a][0]
        near = np.flatnonzero(np.abs(lags * step + offset) < DISTINCT_S)
        if not near.size or found[near].max() < LEAST_CORRELATION:
            return 0.0
        best = int(near[np.argmax(found[near])])
        delays.append(offset + (lags[best] + _vertex(found, best)) * step)
    apart = (t_a[-1] - t_a[0]) / 2
    return (delays[1] - delays[0]) / apart if abs(delays[1] - delays[0]) > step else 0.0


def _speed(t: np.ndarray, value: np.ndarray, step: float) -> np.ndarray:
    """Speeds on an even grid, fast and slow motions alike in size, without their mean."""
    grid = np.arange(t[0], t[-1], step)
    even = np.stack([np.interp(grid, t, column) for column in value.T], axis=1)
    speed = np.linalg.norm(np.diff(even, axis=0), axis=1)
    speed = np.sqrt(speed / max(float(speed.max()), 1e-300))
    return speed - speed.mean()


def _correlation(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps by which b comes later than a, and the correlation there."""
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    product = np.fft.irfft(np.fft.rfft(b, size) * np.conj(np.fft.rfft(a, size)), size)
    lags = np.arange(-(len(a) - 1), len(b))
    return lags, product[lags % size] / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)


def _vertex(y: np.ndarray, at: int) -> float:
    """Where the parabola through a peak and its neighbours is highest, from the peak."""
    if not 0 < at < len(y) - 1:
        return 0.0
    below, here, above = y[at - 1 : at + 2]
    bend = below - 2 * here + above
    return float(np.clip(0.5 * (below - above) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def standstills(t: np.ndarray, value: np.ndarray, within: float, still: RestRule) -> list[tuple[float, float]]:
    """Begin and end (s) of the stretches in which each column of value (T, k) stays within a range, without their settling."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    rows = max(int(np.ceil(still.seconds / np.median(np.diff(t)))), 2)
    low, high = (of(value, rows, axis=0, mode="nearest") for of in (minimum_filter1d, maximum_filter1d))
    calm = maximum_filter1d(((high - low).max(axis=1) <= within).astype(np.int8), rows)
    edges = np.flatnonzero(np.diff(np.r_[0, calm, 0]))
    out = []
    for begin, end in zip(edges[::2], edges[1::2] - 1, strict=True):
        creeping = np.ptp(value[begin : end + 1], axis=0).max() > CREEP * within
        if not creeping and t[end] - t[begin] >= still.seconds:
            out.append((float(t[begin]) + still.settle_s, float(t[end])))
    return out


def even_times(t: np.ndarray) -> tuple[np.ndarray, str]:
    """Times of a log without its bursts, and a sentence on them; unchanged times without bursts."""
    step = np.diff(t)
    if (step < BURST_STEP * step.mean()).mean() < BURST_SHARE:
        return t, ""
    index = np.arange(len(t))
    slope, begin = np.polyfit(index, t - t[0], 1)
    even = t[0] + begin + slope * index
    rows = len(t) / max(int((step >= BURST_STEP * step.mean()).sum()), 1)
    if np.abs(even - t).max() > 3 * rows * slope:  # pauses as well: even times would be wrong
        return t, f"its times come in bursts of about {rows:.0f} rows, with pauses between; they are used as they stand"
    return even, f"its times come in bursts of about {rows:.0f} rows; even ones, {1e3 * slope:.3g} ms apart, are used in their place"


def _read(path: Path, names: Mapping[str, str]) -> Table:
    table = read_table(path, LOG, names=names)
    table.expect_decimals([name for name in table.columns if name != table.heading("time")])
    if len(table) < LEAST_ROWS:
        raise ConfigError(f"{path}: {len(table)} rows; a log of a motion has at least {LEAST_ROWS}")
    return table


def _log(table: Table, value: np.ndarray, joints: bool) -> tuple[_Log, list[str]]:
    t = in_seconds(table.time("time"))
    if (np.diff(t) < 0).any():
        row = int(np.argmax(np.diff(t) < 0)) + 1
        raise ConfigError(f"{table.where(row, 'time')}: the time goes back; sort the rows, or give one recording")
    if (step := float(np.median(np.diff(t)))) > LONGEST_STEP_S:
        raise ConfigError(
            f"{table.where(0, 'time')}: {step:.3g} s from row to row, which cannot be s; name the column with its unit, such as time_ns"
        )
    even, sentence = even_times(t)
    keep = np.r_[True, np.diff(even) > 0]
    kept = _Log(table.rows(keep), even[keep], value[keep], "joints" if joints else "flange")
    return kept, [f"{table.path.name}: {sentence}"] if sentence else []


def _arm(table: Table) -> tuple[PoseHeadings | None, np.ndarray]:
    """The pose of the flange (None: joint angles), and what moves, in rad or mm."""
    joints = joint_columns(table)
    if joints:
        return None, joint_angles(table, joints)
    hand = flange_group(table)
    if hand is None:
        raise ConfigError(
            f"{table.path}:{table.heading_line}: no columns give joint angles or the pose of the flange (the header has: "
            f"{', '.join(table.columns)}); name them q1_deg .. or flange_x_mm .., or say --column OURS=FILE"
        )
    return hand, table.numbers(hand.translation) * (hand.with_units(table).length or 1.0)


def _target(table: Table) -> PoseHeadings:
    found = groups(table)
    named = [g for g in found if role(g) == "target"]
    if not found:
        raise ConfigError(
            f"{table.path}:{table.heading_line}: no columns give what was measured (the header has: {', '.join(table.columns)}); name them "
            "target_x_mm, target_y_mm, target_z_mm, or say --column OURS=FILE"
        )
    return (named or found)[0]


def _table(
    arm: _Log, eye: _Log, hand: PoseHeadings | None, seen: PoseHeadings, delay: ClockDelay, stands: Sequence[tuple[float, float]]
) -> tuple[Table, int]:
    """A row for each standstill in which something was measured, and how many these are."""
    rows: list[tuple[np.ndarray, np.ndarray]] = []
    for begin, end in stands:
        of_arm = np.flatnonzero((arm.time_s >= begin) & (arm.time_s <= end))
        t = delay.of_instrument(np.array([begin, end]))
        of_eye = np.flatnonzero((eye.time_s >= t[0]) & (eye.time_s <= t[1]))
        if of_arm.size and of_eye.size:
            rows.append((of_arm, of_eye))
    columns: dict[str, tuple[str, ...]] = {"time_s": tuple(numbers(np.array([arm.time_s[a].mean() for a, _ in rows])))}
    joints = joint_columns(arm.table) if hand is None else []
    for k in range(len(joints)):
        angles = np.array([arm.value[a, k].mean() for a, _ in rows])
        columns[f"q{k + 1}_rad"] = tuple(numbers(angles))
    for thing, table, group, side in (("flange", arm.table, hand, 0), ("target", eye.table, seen, 1)):
        if group is None:
            continue
        for name in group.translation:
            columns[f"{thing} {_bare(name, group.length)}"] = _means(table, name, [pair[side] for pair in rows])
        for name in group.rotation:  # an orientation has no mean number by number
            values = table.number(name)
            columns[f"{thing} {_bare(name)}"] = tuple(numbers(values[[pair[side][len(pair[side]) // 2] for pair in rows]]))
    lines = [arm.table.line[a[0]] for a, _ in rows]
    return Table(arm.table.path, columns, lines), len(rows)


def _bare(name: str, length: float | None = None) -> str:
    """A heading without the word of the thing: its component and unit, or that of ``length`` (mm), which lines above stated."""
    part = heading(name)
    if part.component in RTDE_POSE:
        return f"tcp_pose_{part.component}"
    unit = part.unit or next((unit for unit, size in LENGTHS.items() if size == length), "")
    return f"{part.component} [{unit}]" if unit else part.component


def _means(table: Table, name: str, rows: Sequence[np.ndarray]) -> tuple[str, ...]:
    values = table.number(name)
    return tuple(numbers(np.array([values[at].mean() for at in rows])))
