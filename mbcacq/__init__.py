"""Acquire with a robot-mounted 3D scanner, calibrate the cell, diagnose what the model lacks.

    import mbcacq

    plan = mbcacq.load_plan("plans/quick.yaml")
    done = mbcacq.run(plan, dry_run=True)                 # recorded, calibrated, verified, in a folder of its own
    data = mbcacq.load_observations("ur5-tracker")        # a run folder, a .rrd, an observation set
    cell = mbcacq.calibrate(data)                         # cell.errors (n, 5), cell.covariance (g, g), cell.to_base(q, xyz)
    mbcacq.check(done.folder, plan, dry_run=True)         # a few poses again: did anything change since, what, where, since when
    mbcacq.collect(plan, "clouds")                        # a run of clouds that the scanner's own program saved
    mbcacq.verify(data, cell)                             # sphere spacing errors before and after, mm
    better = mbcacq.calibrate(data, effects=mbcacq.diagnose(data))   # the same cell with the effects that were found
    mbcacq.verify_elsewhere("another-day", better)        # that arm and its effects on another recording
    mbcacq.calibrate_together(["monday", "friday"])       # one arm from several recordings
    mbcacq.compare(data)                                  # the methods of calibration on the same data
    found = mbcacq.diagnose(data)                         # found.verdict, found.effects, found.write_html("diagnosis.html")
    twin = mbcacq.simulate(plan, cell)                    # what that cell would record
    mbcacq.write_report(cell, "report.html")
    mbcacq.export(cell, results="for-the-controller")

Lengths are mm, angles rad, time s, mass kg inside the program; degrees appear only in YAML, CSV and on the KUKA wire.
A transform ``T_base_flange`` takes coordinates in the flange frame to coordinates in the base frame.

Names are imported when they are first used: ``import mbcacq`` alone takes a few milliseconds.
"""

from __future__ import annotations

from mbcacq.version import __version__

TYPE_CHECKING = False  # type checkers take it for True; importing typing takes longer than all the rest
if TYPE_CHECKING:
    from mbcacq.calibration.calibrated_cell import CalibratedCell as CalibratedCell
    from mbcacq.calibration.compare_methods import Comparison as Comparison
    from mbcacq.calibration.verification import Verification as Verification
    from mbcacq.design.adaptive.investigation import Budget as Budget
    from mbcacq.design.new_plan import NewPlanOptions as NewPlanOptions
    from mbcacq.estimation.options import CalibrationOptions as CalibrationOptions
    from mbcacq.exports.format import Targets as Targets
    from mbcacq.fleet.evaluate import Fleet as Fleet
    from mbcacq.fleet.evaluate import evaluate_fleet as evaluate_fleet
    from mbcacq.fleet.evaluation import FleetTask as FleetTask
    from mbcacq.interim_check.check import CheckSettings as CheckSettings
    from mbcacq.interim_check.check import InterimCheck as InterimCheck
    from mbcacq.interim_check.check import check as check
    from mbcacq.model.observations import Observations as Observations
    from mbcacq.model.trajectory import Trajectory as Trajectory
    from mbcacq.plan.planned import LoadedPlan as LoadedPlan
    from mbcacq.workflow.calibrate import calibrate as calibrate
    from mbcacq.workflow.calibrate import calibrate_together as calibrate_together
    from mbcacq.workflow.calibrate import compare as compare
    from mbcacq.workflow.calibrate import verify as verify
    from mbcacq.workflow.calibrate import verify_elsewhere as verify_elsewhere
    from mbcacq.workflow.collect import Sources as Sources
    from mbcacq.workflow.collect import collect as collect
    from mbcacq.workflow.correct import correct as correct
    from mbcacq.workflow.diagnose import diagnose as diagnose
    from mbcacq.workflow.diagnosis_result import DiagnosisResult as DiagnosisResult
    from mbcacq.workflow.evaluate import RunResult as RunResult
    from mbcacq.workflow.export import export as export
    from mbcacq.workflow.extend import extend as extend
    from mbcacq.workflow.investigate import investigate as investigate
    from mbcacq.workflow.load import load_observations as load_observations
    from mbcacq.workflow.load import load_plan as load_plan
    from mbcacq.workflow.load import load_trajectories as load_trajectories
    from mbcacq.workflow.new_plan import new_plan as new_plan
    from mbcacq.workflow.next_plan import next_plan as next_plan
    from mbcacq.workflow.next_plan import next_poses as next_poses
    from mbcacq.workflow.report import write_report as write_report
    from mbcacq.workflow.run import Operator as Operator
    from mbcacq.workflow.run import run as run
    from mbcacq.workflow.simulate import simulate as simulate

_MODULES = {
    "calibration.calibrated_cell": ("CalibratedCell",),
    "calibration.compare_methods": ("Comparison",),
    "calibration.verification": ("Verification",),
    "design.new_plan": ("NewPlanOptions",),
    "estimation.options": ("CalibrationOptions",),
    "exports.format": ("Targets",),
    "fleet.evaluate": ("Fleet", "evaluate_fleet"),
    "fleet.evaluation": ("FleetTask",),
    "interim_check.check": ("InterimCheck", "CheckSettings", "check"),
    "model.observations": ("Observations",),
    "model.trajectory": ("Trajectory",),
    "plan.planned": ("LoadedPlan",),
    "workflow.calibrate": ("calibrate", "calibrate_together", "compare", "verify", "verify_elsewhere"),
    "workflow.collect": ("Sources", "collect"),
    "workflow.correct": ("correct",),
    "workflow.diagnose": ("diagnose",),
    "workflow.diagnosis_result": ("DiagnosisResult",),
    "workflow.evaluate": ("RunResult",),
    "workflow.export": ("export",),
    "design.adaptive.investigation": ("Budget",),
    "workflow.extend": ("extend",),
    "workflow.investigate": ("investigate",),
    "workflow.load": ("load_observations", "load_plan", "load_trajectories"),
    "workflow.new_plan": ("new_plan",),
    "workflow.next_plan": ("next_plan", "next_poses"),
    "workflow.report": ("write_report",),
    "workflow.run": ("Operator", "run"),
    "workflow.simulate": ("simulate",),
}
_MODULE_OF = {name: f"mbcacq.{module}" for module, names in _MODULES.items() for name in names}
__all__ = ["__version__", *_MODULE_OF]  # pyright: ignore[reportUnsupportedDunderAll]  # type checkers go by the names above


if not TYPE_CHECKING:  # a type checker would take any name for known

    def __getattr__(name: str) -> object:
        if name not in _MODULE_OF:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        import importlib

        value = getattr(importlib.import_module(_MODULE_OF[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__} - {"TYPE_CHECKING", "annotations"})
