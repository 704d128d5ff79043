"""What was changed in a MuJoCo model so that it agrees with a recording: plain data, as text and JSON, and the model itself."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, isfinite, log10
from pathlib import Path

from mbcacq.files.atomic_write import write_file
from mbcacq.model.json_text import AsJson, Number
from mbcacq.quantities import K, significant, symbol, uncertainty

RUNS, TORQUES, POSES = "runs", "torques", "poses"  # what a recording is compared with
AT_NOISE = 1.2  # times the noise, which is itself an estimate to some per cent: up to that a held-out channel is explained
BETTER = 0.9  # of the error before: up to that a channel that is not at the noise is explained in part


@dataclass(frozen=True)
class ModelParameter:
    """One number of the model.

    Attributes
    ----------
    name, where : str
        Name and location of its block, e.g. 'friction' at joint 'A2'.
    parameter : str
        Name of the parameter, with its unit.
    before, after : Number
        Value in the model as it was given and as found.
    std : Number
        Standard deviation, nan where none is known.
    p_value : Number
        The p-value of the block's difference from the model as it was given.
    named : bool
        Whether the diagnosis named it; otherwise it was added because of the residual.
    """

    name: str
    where: str
    parameter: str
    before: Number
    after: Number
    std: Number
    p_value: Number
    named: bool

    @property
    def given(self) -> str:
        """The value before in digits, without the rounding errors of the model's arithmetic."""
        return f"{float(to_precision(self.before, self.std)):.6g}"

    @property
    def found(self) -> str:
        """The value after in digits, to the second one of its standard deviation."""
        return to_precision(self.after, self.std)


@dataclass(frozen=True)
class ChannelError:
    """Root mean squares of a channel, in its unit: of its noise, of the model as it was given, of the model found."""

    channel: str
    unit: str
    noise: Number
    before: Number
    after: Number


@dataclass(frozen=True)
class ModelCheck:
    """Errors in a held-out recording."""

    recording: str
    errors: tuple[ChannelError, ...]


@dataclass(frozen=True, kw_only=True)
class ModelMatch(AsJson):
    """A MuJoCo model with what was found in recordings.

    Attributes
    ----------
    model : str
        The file that was given.
    xml : str
        The model found, as MJCF.
    parameters : tuple[ModelParameter, ...]
        The parameters that changed.
    compared : str
        'runs' of the model by its servos, 'torques' along the recorded motion, or 'poses'.
    errors : tuple[ChannelError, ...]
        Error of each channel; each part of the recordings is predicted by a fit to the others.
    checks : tuple[ModelCheck, ...]
        Checks on held-out recordings.
    remarks : tuple[str, ...]
        Sentences on effects that a model cannot hold.
    """

    model: str
    xml: str
    parameters: tuple[ModelParameter, ...]
    compared: str
    errors: tuple[ChannelError, ...]
    checks: tuple[ModelCheck, ...] = ()
    remarks: tuple[str, ...] = ()

    def write(self, path: Path | str) -> Path:
        """Write the model with what was found. Raises ConfigError if the file cannot be written."""
        return write_file(path, self.xml)

    @property
    def verdict(self) -> str | None:
        """What the model found leaves of held-out channels, as a verdict of a diagnosis; None if MuJoCo was not run by the set points.

        These runs decide, and not the torque along the recorded motion by which the mismatch was located: that is linear, and has the
        error of angles that were differentiated twice.
        """
        if self.compared != RUNS:
            return None
        errors = [e for check in self.checks for e in check.errors] or list(self.errors)
        if all(e.after <= AT_NOISE * e.noise for e in errors):
            return "explained" if self.parameters else "none"
        better = any(e.before > AT_NOISE * e.noise and e.after < BETTER * e.before for e in errors)
        return "partly_explained" if better else "unexplained"

    @property
    def text(self) -> str:
        """In plain lines, as the command line prints it."""
        name = Path(self.model).name
        lines = ["", f"Written into {name} (± U, k = 2):" if self.parameters else f"Nothing is to be changed in {name}."]
        for p in self.parameters:
            std = "" if p.std != p.std else f" ± {uncertainty(K * p.std)}"
            lines.append(f"  {p.where:<12} {p.parameter:<24} {p.given} -> {p.found}{std}")
        lines += [f"  ({remark})" for remark in self.remarks]
        if self.compared != POSES:
            what = "new runs of MuJoCo by the recorded set points" if self.compared == RUNS else "MuJoCo's torque along the recorded motion"
            lines += ["", f"Recorded against {what}, on held-out parts (rms before, after, noise):", *_rows(self.errors)]
        else:
            lines += ["", *(f"  {e.channel}: {significant(e.after, 2)} {symbol(e.unit)}" for e in self.errors)]
        for check in self.checks:
            lines += ["", f"In {check.recording}, held out:", *_rows(check.errors)]
        return "\n".join(lines)


def to_precision(value: float, std: float) -> str:
    """A value to the second digit of its standard deviation."""
    if not (isfinite(value) and isfinite(std) and std > 0):
        return f"{value:.6g}"
    decimals = 1 - floor(log10(std))
    rounded = round(value, decimals) + 0.0  # no minus before a zero
    return f"{rounded:.{max(decimals, 0)}f}" if rounded else "0"


def _rows(errors: tuple[ChannelError, ...]) -> list[str]:
    return [
        f"  {e.channel:<12} {significant(e.before)} -> {significant(e.after)} {symbol(e.unit)} (noise {significant(e.noise, 2)})"
        for e in errors
    ]
