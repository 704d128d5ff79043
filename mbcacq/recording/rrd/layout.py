"""Where everything stands in a recording: files, timelines, entity paths, components. Writer, reader and blueprint share it.

Entities under ``/world`` are for display (float32, mm, base frame); what a solver reads stands in the archetypes ``mbcacq.*``: under
``/observation`` as float64, under ``/cycles`` packed without loss. docs/recording.md holds the table for users.
"""

from __future__ import annotations

import re
from pathlib import Path

APPLICATION = "mbcacq"
VERSION = 2  # 1: cycles a row each

# Timelines. TIME: duration since the run started. ROBOT_TIME: duration on the controller's clock. POSE: number in the plan. STEP: index
# of the plan's step. CLOCK: date and time of day, UTC.
TIME, ROBOT_TIME, POSE, STEP_INDEX, CLOCK = "time", "robot_time", "pose", "step", "clock"

# Static: the run as data.
RUN = "run"  # mbcacq.Run
PLAN, CELL = "plan", "cell"  # TextDocument, the full YAML; mbcacq.Text: its sha256
CELL_COPY = "cell_copy"  # the same again: without its cell no recording can be calibrated
PLAN_FILES = "plan_files"  # TextDocument: JSON of the files that the plan names, and which cell was driven; mbcacq.Text

# The course of the run.
STATE, STEP, STATION = "run/state", "run/step", "run/station"  # StateChange
LOG = "log"  # TextLog
HEALTH = "health"  # health/DEVICE/QUANTITY: Scalars
TEMPERATURE = "motion/temperature_C"  # motion/temperature_C/QUANTITY: the temperatures of health and sensors

# Measured.
CYCLES = "cycles"  # mbcacq.Cycles, one row a batch of controller cycles, packed (before: one row a cycle)
PACKED = "packed"  # component of it
JOINTS, FOLLOWING, CURRENT = "joints/measured", "joints/set_minus_measured", "joints/current"  # Scalars: deg, deg, percent
AXES_KEY = "joints/names"  # Points2D: names and colours of the axes, beside their curves
SET, PERIOD, DELAY = "joints/set", "motion/period_ms", "motion/late_answers"  # Scalars: deg; ms by controller, by this computer; count
SCAN = "world/scan"  # Transform3D (T_base_scanner), mbcacq.Scan with the packed points (scanner frame); whole clouds as Points3D
ON_BALLS, BACKGROUND = "world/scan/on_balls", "world/scan/beside"  # Points3D for display: by distance to the ball; the rest
SWEEP = "sweep"  # mbcacq.Sweep: profiles of a line scanner over one ball, and where it was expected
EXPOSURE = "exposure"  # mbcacq.Centres of one exposure
OBSERVATION = "observation"  # mbcacq.Pose and mbcacq.Centres: mean over the exposures; what load_observations reads
BALLS_FOUND, FIT_RMS, SCATTER = "quality/balls_found", "quality/fit_rms_um", "quality/exposure_scatter_um"  # Scalars
LIMITS = "spheres/limit"  # .../NAME: Scalars, the limits that the spheres are judged by
BALL_POINTS, BALL_RMS, BALL_FORM, BALL_SIZE = (  # Scalars, one value a ball of the cell (NaN where not found)
    "spheres/points",
    "spheres/rms_um",
    "spheres/form_um",
    "spheres/radius_error_um",
)

INVESTIGATION_FILE = "investigation.json"  # decisions of a run whose poses were chosen one visit after the other

# An investigation: once a visit, before it is measured.
ODDS, COULD_HIDE = "investigation/odds", "investigation/could_hide"  # .../NAME: Scalars, log10 against the first set; usual sizes
NEXT = "world/next"  # LineStrips3D from the scanner to what it will look at, of the poses to come

# The scene.
WORLD = "world"
ROBOT = "world/robot"  # world/robot/linkI: Transform3D T_base_link
URDF = "urdf"  # the arm's shapes and joints, where the plan names a URDF
SCANNER = "world/robot/scanner"  # Transform3D T_base_scanner; frustum and housing below
STATIONS = "world/stations"  # world/stations/ID: balls where they were measured, base frame
PATH = "world/path"  # LineStrips3D of the flange, one a pose: done and to come
OBSTACLES = "world/obstacles"  # Boxes3D
STAND = "world/stand"  # Cylinders3D of a motorised stand at the station that it is at

# The result, in a file of its own with the same recording id.
RESIDUAL = "result/residual_um"  # result/residual_um/after, before: Scalars, mean of a pose along x, y, z
RESIDUAL_BALL = "result/residual"  # mbcacq.Residual: float64, every centre
RMS_POSE = "result/rms_pose_um"  # .../before, .../after: Scalars, 3D rms of a pose
PLAN_SHOWN, CELL_SHOWN = "view/plan", "view/cell"  # TextDocument: the texts in characters that the viewer can draw
VIEW = "view"  # TextDocument, only in the small file that ``mbcacq view`` opens first
SUMMARY = "result/summary"  # TextDocument
VERDICT = "result/verdict"  # TextDocument: the verdict, and the one number against its limit
LENGTHS = "result/length_error"  # chart (2D): error of each certified length with its uncertainty and the limit
ENLARGED = "result/enlarged"  # mbcacq.Enlarged: how many times longer than they are arrows are drawn
CALIBRATED = "world/calibrated"  # world/calibrated/STATION: Transform3D T_base_station, certified balls
ARROWS = "world/residuals"  # Arrows3D of the pose, enlarged
ALL_ARROWS = "result/arrows"  # result/arrows/before, after: Arrows3D of all poses, enlarged alike

# The diagnosis, in a file of its own with the same recording id.
DIAGNOSIS = "diagnosis"
DIAGNOSIS_TEXT = "diagnosis/text"  # TextDocument
DIAGNOSIS_ARROWS = "diagnosis/cell/arrows"  # .../before, .../after
DIAGNOSIS_BALLS = "diagnosis/cell/balls"  # Points3D, recorded centres
CAUSE = "diagnosis/cause"  # diagnosis/cause/NAME: Scalars, the variable that an effect depends on
RESPONSES = "diagnosis/responses"  # diagnosis/responses/K: chart (2D), displacement over its own variable before and after
MOTION_TEXT = "diagnosis/motion/text"  # TextDocument
MOTION_CHANNELS = "diagnosis/motion/channels"  # .../RECORDING/CHANNEL/JOINT/measured, model/before, model/after, residual/..: Scalars
MISFIT = "diagnosis/residual_um"  # .../before, .../after: Scalars, 3D rms of a pose

RUN_ARCHETYPE, POSE_ARCHETYPE, CENTRES_ARCHETYPE = "mbcacq.Run", "mbcacq.Pose", "mbcacq.Centres"
CYCLES_ARCHETYPE, SCAN_ARCHETYPE, RESIDUAL_ARCHETYPE = "mbcacq.Cycles", "mbcacq.Scan", "mbcacq.Residual"
SWEEP_ARCHETYPE = "mbcacq.Sweep"
ENLARGED_ARCHETYPE, TEXT_ARCHETYPE = "mbcacq.Enlarged", "mbcacq.Text"
DIGEST = "sha256"  # of the other values of a row

# Files of a run folder.
RUN_FILE, RESULT_FILE, JOURNAL_FILE, LOG_FILE = "run.rrd", "result.rrd", "journal.jsonl", "log.jsonl"
DIAGNOSIS_FILE = "diagnosis.rrd"
RECOVERED = ".recovered"
_PART = re.compile(r"run(?:\.part(\d+))?\.rrd")


def link(i: int) -> str:
    """Entity of the i-th link's frame, 0 = base, n = flange."""
    return f"{ROBOT}/link{i}"


def part_name(part: int) -> str:
    """File name of the part-th recording of a run (0: the run as first started; more where it was resumed)."""
    return RUN_FILE if part == 0 else f"run.part{part + 1}.rrd"


def parts(folder: Path) -> list[Path]:
    """The recordings of a run folder in the order they were made; a recovered copy stands in for its torn original."""
    found = _by_number(folder)
    for path in folder.glob(f"run*{RECOVERED}*.rrd"):
        match = _PART.fullmatch(re.sub(rf"{re.escape(RECOVERED)}(-\d+)?", "", path.name))
        number = int(match[1] or 1) if match else 0
        if match and number not in found:
            found[number] = path
    return [recovered_of(found[number]) or found[number] for number in sorted(found)]


def originals(folder: Path) -> list[Path]:
    """The recordings of a run folder as they were written, in order, recovered copies left out."""
    return [path for _, path in sorted(_by_number(folder).items())]


def next_part(folder: Path) -> int:
    """Number of the recording that comes next in a run folder (0 where it holds none)."""
    return max(_by_number(folder), default=0)


def _by_number(folder: Path) -> dict[int, Path]:
    return {int(match[1] or 1): path for path in folder.glob("run*.rrd") if (match := _PART.fullmatch(path.name))}


def recovered_of(path: Path) -> Path | None:
    """The newest recovered copy next to a recording, or None."""
    pattern = re.compile(re.escape(path.stem + RECOVERED) + r"(?:-(\d+))?\.rrd")
    copies = {int(match[1] or 1): other for other in path.parent.glob("*.rrd") if (match := pattern.fullmatch(other.name))}
    return copies[max(copies)] if copies else None


def next_recovered(path: Path) -> Path:
    """A free name for a recovered copy of ``path``: NAME.recovered.rrd, NAME.recovered-2.rrd..."""
    stem = re.sub(rf"{re.escape(RECOVERED)}(-\d+)?$", "", path.stem)
    number = 1
    while (candidate := path.with_name(f"{stem}{RECOVERED}{'' if number == 1 else f'-{number}'}.rrd")).exists():
        number += 1
    return candidate
