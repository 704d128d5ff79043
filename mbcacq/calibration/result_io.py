"""A result.json read: the cell that it holds, what must be said of it, and what the recording alone says.

The result of several recordings, format 'mbcacq-joint-result/1', is one result for each, all with the same arm and effects. One of them is
named by its number behind the file: ``result.json#2`` is the cell of the second recording.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration import notebook
from mbcacq.calibration.observation_fit import Parameter
from mbcacq.calibration.result_file import CURE, FORMAT, THE_RESULT, ResultFile, result_of
from mbcacq.calibration.sufficiency import refuse_other_arm
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError, command_line
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.files.atomic_write import finish_set, write_file
from mbcacq.geometry import se3
from mbcacq.model.cell import SIMULATED, Cell, counted_axes, link_parameters
from mbcacq.model.formats import newer_format
from mbcacq.model.json_text import damage, damaged, read_json, sealed_text, unsealed
from mbcacq.quantities import K, fixed, pair, symbol, uncertainty

MAX_BYTES = 256 << 20  # a joint result of a hundred recordings has a tenth of that


def axes_of(result: Mapping[str, Any]) -> tuple[str, ...]:
    """(n,) names of the axes of the arm of a result.json."""
    return tuple(result["robot"].get("axes") or counted_axes(len(result["robot"]["sign"])))


def of_flange_poses(result: Mapping[str, Any]) -> bool:
    """Whether the cell of a result is known by the poses of its flange alone: it has no joints, links, limits, effects or kinematics."""
    return bool(result.get("robot", {}).get("flange_poses", False))


def noise_of_a_view(result: Mapping[str, Any]) -> tuple[float, float] | None:
    """Standard deviation of one view of a target, scanner and pose of the flange together: mm of a coordinate, and rad about an axis. None
    where the data, or a stated noise, tell their shares apart: one target at a pose does not, whatever the adjustment settles on."""
    noise, fit = result["noise"], result["fit"]
    if not of_flange_poses(result) or fit["centres"] > fit["poses"] or noise.get("check_factor"):
        return None
    carrier = np.asarray(noise["joint_rad"], dtype=float)
    place = np.mean(np.square(noise["scanner_mm"])) + np.mean(carrier[:3] ** 2)
    return float(np.sqrt(place)), float(np.sqrt((noise.get("turn_rad") or 0.0) ** 2 + np.mean(carrier[3:] ** 2)))


ONE_VIEW = "one target at a pose does not tell their shares apart"


def effects_of(result: Mapping[str, Any]) -> EffectModel | None:
    """The effects of a result; None if it is geometry alone. Raises ConfigError if they are damaged."""
    return EffectModel.from_dict(result["effects"]) if result.get("effects") else None


def state_from_dict(content: Mapping[str, Any], cell: Cell | None = None, *, other: str = "the recording") -> CellState:
    """The calibrated cell of a result. With ``cell``, its stations and balls are filled in that cell's order (identity where unknown);
    without, in the result's. other: what has that cell. Raises ConfigError if this is no such result, or the cell has another arm."""
    file = result_of(content)
    if cell is None:
        return file.state
    refuse_other_arm("the result is of", file.robot.name, file.robot.nominal_chain, cell.robot, other)
    placed, balls = {s.id: s.T_base_station for s in file.stations}, {b.id: b.centre_mm for b in file.balls}
    stations = np.array([placed.get(s.id, np.eye(4)) for s in cell.stations])
    centres = np.array([balls.get(b, c) for b, c in zip(cell.ball_ids, cell.ball_centres, strict=True)])
    return CellState(file.robot.chain, file.T_flange_scanner, stations, centres)


def layout_of(file: ResultFile, source: str = THE_RESULT) -> ParameterLayout:
    """Names and freedom of the parameters of a result: blocks of chain, hand-eye and balls, and one of all effects, if there are any.

    Raises ConfigError if the names are in another order.
    """
    free, reported = set(file.names), {p.name: p for p in file.parameters}
    groups = {
        "chain": list(link_parameters(file.robot.names)),
        "hand_eye": [f"hand_eye.{c}" for c in parameters.HAND_EYE],
        "balls": [f"ball_{b.id}.{c}" for b in file.balls for c in "xyz"],
    }
    known = {name for names in groups.values() for name in names}
    if effects := [name for name in file.names if name not in known]:
        groups["effects"] = effects
    layout = ParameterLayout(tuple(_block(block, names, free, reported) for block, names in groups.items()))
    if layout.names != file.names:
        raise damaged(source, "names are not in the order of arm, hand-eye, balls, effects", CURE)
    return layout


def _block(block: str, names: Sequence[str], free: set[str], reported: Mapping[str, Parameter]) -> parameters.ParameterBlock:
    units = tuple(reported[name].unit if name in reported else "" for name in names)
    why = {name: reported[name].reason for name in names if name in reported and reported[name].status == "held"}
    size = len(names)
    is_free = np.array([name in free for name in names], dtype=bool)
    return parameters.ParameterBlock(block, tuple(names), units, is_free, np.full(size, np.inf), np.ones(size), why)


def read_result(path: Path, *, any_of_them: bool = False) -> dict[str, Any]:
    """The content of a result.json, given itself or by its run folder; one of several recordings is given by its number (result.json#2), or
    without a number where ``any_of_them`` will do. Raises ConfigError naming file and what is wrong."""
    path, number = split_number(path)
    if path.is_dir():
        finish_set(path)
    file = path / "result.json" if path.is_dir() else path
    try:
        if file.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{file} is larger than {MAX_BYTES >> 20} MiB, so it is no calibration result; {CURE}")
        text = file.read_bytes()
    except OSError as error:
        cure = "give a result.json, or the run folder that holds one"
        if path.is_dir() and ((path / "run.rrd").exists() or (path / "cell.yaml").exists()):
            cure = f"this recording is not calibrated yet: {command_line('calibrate', path, '--out', file)}"
            if (path / "run.rrd").exists():
                cure += f", or {command_line('run', '--resume', path)} if it was interrupted"
        raise ConfigError(f"cannot read {file}: {error.strerror}; {cure}") from error
    content = result_of_one(read_json(text, str(file), CURE), number, file, any_of_them=any_of_them)
    result_of(content, str(file))
    if content.get("effects"):
        EffectModel.from_dict(content["effects"], str(file), "effects")
    return content


def html(result: Mapping[str, Any]) -> str:
    """The free parameters of a result as an HTML table, in mm and degrees."""
    rows = []
    for p in result["parameters"]:
        if p["std"] is not None and not p["name"].startswith("ball_"):
            scale, unit = (180 / np.pi, "°") if p["unit"] == "rad" else (1.0, symbol(p["unit"]))
            U = K * scale * p["std"]
            rows.append((p["name"], unit, *(pair(scale * p[key], U)[0] for key in ("value", "error")), uncertainty(U)))
    return notebook.table(f"{result['robot']['name']}, calibrated", ("parameter", "unit", "value", "error", "U (k = 2)"), rows)


JOINT_FORMAT = "mbcacq-joint-result/1"


def joint_content(results: Sequence[dict[str, Any]], names: Sequence[str]) -> dict[str, Any]:
    """JSON content of the results of several recordings of these names. 'day_to_day': for each coefficient of the effects on the arm its
    values in the recordings, what they have in common and the standard deviation between them; it stands once, not in each result."""
    day_to_day = [one.pop("day_to_day", []) for one in results][0]
    recordings = [{"name": name, "result": one} for name, one in zip(names, results, strict=True)]
    return {"format": JOINT_FORMAT, "recordings": recordings, "day_to_day": day_to_day}


def split_number(path: Path) -> tuple[Path, int | None]:
    """The file and the number of the recording in it that a path like ``result.json#2`` names; None if it names none."""
    found = re.fullmatch(r"(.+)#(\d+)", path.name)
    return (path, None) if path.exists() or not found else (path.with_name(found[1]), int(found[2]))


def result_of_one(content: Any, number: int | None, file: Path, *, any_of_them: bool = False) -> Any:
    """The result of one recording in a joint result; any other content as it is. any_of_them: take the first without a number, for what all
    of them share. Raises ConfigError if it is not said which, and where the content's checksum does not hold.
    """
    if isinstance(content, dict) and (sentence := newer_format(content.get("format"), (JOINT_FORMAT, FORMAT))):
        raise ConfigError(f"{file} {sentence}")
    content = unsealed(content, file)
    if not isinstance(content, dict) or content.get("format") != JOINT_FORMAT:
        if number is not None:
            raise ConfigError(f"{file} is not of several recordings; leave out '#{number}'")
        return content
    try:
        names, results = zip(*((str(one["name"]), one["result"]) for one in content["recordings"]), strict=True)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{file}: the joint result is damaged ({damage(error)}); write it anew with mbcacq calibrate") from error
    if number is None and any_of_them:
        number = 1
    if number is None or not 1 <= number <= len(results):
        choice = ", ".join(f"{file}#{i + 1} ({name})" for i, name in enumerate(names))
        raise ConfigError(f"{file} is of {len(results)} recordings with one arm, each with its own tool and stations; give one: {choice}")
    return results[number - 1]


UNVERIFIED = "never verified: no measurement apart from the fit has checked these values (mbcacq verify); do so before they are relied upon"


def export_command(result: Mapping[str, Any], source: object) -> str:
    """The command that writes a result for other programs, as it is accepted. A result of simulated data must be accepted as such. source:
    its file or folder."""
    return command_line("export", source, "--results", "results", *(("--simulated-anyway",) if result.get("simulated") else ()))


def caveats(result: Mapping[str, Any]) -> list[str]:
    """One sentence each, for the content of a result.json: simulated data, values without verification, recordings that contradict it."""
    trials = result.get("trials") or {}
    against = [sentence for sentence in trials.values() if " contradicts " in sentence]
    verified = bool((result.get("verification") or {}).get("places") or result.get("held_out") or trials)
    return [*([SIMULATED] if result.get("simulated") else []), *([] if verified else [UNVERIFIED]), *against]


def note_trials(source: Path, trials: Mapping[str, str]) -> None:
    """Write into the result of one recording how it did on others. source: its file or folder; trials: a sentence for each recording.

    Raises ConfigError where the file cannot be written.
    """
    file = source / "result.json" if source.is_dir() else source
    content = read_result(file)
    write_file(file, sealed_text({**content, "trials": {**(content.get("trials") or {}), **trials}}))


def with_warnings(result: Mapping[str, Any]) -> list[str]:
    """The caveats, a limit that is exceeded, and what the calibration warned of: for a reader of the result who did not see how it was
    made."""
    return [*caveats(result), *filter(None, [beyond_limit(result)]), *(str(warning) for warning in result.get("warnings") or ())]


def beyond_limit(result: Mapping[str, Any]) -> str:
    """A sentence where a sphere spacing error is beyond the plan's limit by more than the uncertainty of judging it, or ''."""
    verified = result.get("verification") or {}
    if verified.get("verdict") != "fail":
        return ""
    largest, limit = fixed(verified["after"]["max_mm"]), verified["limit_mm"]
    return f"the largest sphere spacing error is {largest} mm, beyond the plan's limit of {limit:g} mm"


LEAST_SHARE = 1e-9  # share of a direction's prior variance that the data take away, below which rounding decides


@dataclass(frozen=True)
class OwnEstimate:
    """The estimate of a recording without the prior of the links.

    Attributes
    ----------
    error : Mapping[str, float]
        Error of the arm's parameters, value minus nominal, by name.
    covariance : ndarray
        (g, g) of ``names``.
    T_flange_scanner : ndarray
        (4, 4).
    known : bool
        Whether the result says which prior it used (an older one does not, and its estimates then stay as they are).
    """

    names: tuple[str, ...]
    error: Mapping[str, float]
    covariance: np.ndarray
    T_flange_scanner: np.ndarray
    known: bool

    def std(self, name: str) -> float:
        """Standard deviation of one parameter, of the hand-eye translation along the scanner's axes."""
        at = self.names.index(name)
        return float(np.sqrt(self.covariance[at, at]))


def without_prior(result: Mapping[str, Any]) -> OwnEstimate:
    """The estimates of a result.json without the prior of the links. Priors of balls (their certificate) and of smooth errors stay.

    A prior of the size that link errors have lets every estimate lean towards nominal, by more where the poses determine less. That makes
    the calibrated arm better; between two recordings it makes every change too small. With the posterior N(x, C) and the prior N(m, D) of
    the links, the data alone give N(x + C_l (D - C_ll)^-1 (x_l - m), C + C_l (D - C_ll)^-1 C_l'). C_l are the columns of the links
    (Woodbury's identity applied to the difference of the two informations).
    """
    names, C = tuple(map(str, result["names"])), np.array(result["covariance"], dtype=float)
    T = np.array(result["T_flange_scanner"], dtype=float)
    arm = set(link_parameters(axes_of(result)))
    error = {p["name"]: float(p["error"]) for p in result["parameters"]}
    links = [p for p in result["parameters"] if p["name"] in arm and p["status"] == "prior"]
    if any(p.get("prior_std") is None for p in links) or not links:
        return OwnEstimate(names, error, C, T, not links)
    at = [names.index(p["name"]) for p in links]
    size = np.array([float(p["prior_std"]) for p in links])
    away = np.array([float(p["error"]) - float(p.get("prior_mean", 0.0)) for p in links])
    value, vector = np.linalg.eigh(np.eye(len(at)) - C[np.ix_(at, at)] / size[:, None] / size)
    root = C[:, at] / size @ (vector / np.sqrt(np.maximum(value, LEAST_SHARE)))
    shift = root @ (vector.T @ (away / size) / np.sqrt(np.maximum(value, LEAST_SHARE)))
    own = {name: error[name] + float(shift[i]) for i, name in enumerate(names) if name in error and not name.startswith("hand_eye.")}
    turned = np.array([shift[names.index(f"hand_eye.{c}")] if f"hand_eye.{c}" in names else 0.0 for c in ("x", "y", "z", "rx", "ry", "rz")])
    return OwnEstimate(names, error | own, C + root @ root.T, T @ se3.exp(turned), True)
