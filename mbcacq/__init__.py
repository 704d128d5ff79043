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
    from mbcacq.calibration.calibrated_cell import CalibratedCell
    from mbcacq.calibration.compare_methods import Comparison
    from mbcacq.calibration.verification import Verification
    from mbcacq.design.adaptive.investigation import Budget
    from mbcacq.design.new_plan import NewPlanOptions
    from mbcacq.estimation.options import CalibrationOptions
    from mbcacq.exports.format import Targets
    from mbcacq.fleet.evaluate import Fleet, evaluate_fleet
    from mbcacq.fleet.evaluation import FleetTask
    from mbcacq.interim_check.check import CheckSettings, InterimCheck, check
    from mbcacq.model.observations import Observations
    from mbcacq.model.trajectory import Trajectory
    from mbcacq.plan.planned import LoadedPlan
    from mbcacq.workflow.calibrate import calibrate, calibrate_together, compare, verify, verify_elsewhere
    from mbcacq.workflow.collect import Sources, collect
    from mbcacq.workflow.correct import correct
    from mbcacq.workflow.diagnose import diagnose
    from mbcacq.workflow.diagnosis_result import DiagnosisResult
    from mbcacq.workflow.evaluate import RunResult
    from mbcacq.workflow.export import export
    from mbcacq.workflow.extend import extend
    from mbcacq.workflow.investigate import investigate
    from mbcacq.workflow.load import load_observations, load_plan, load_trajectories
    from mbcacq.workflow.new_plan import new_plan
    from mbcacq.workflow.next_plan import next_plan, next_poses
    from mbcacq.workflow.report import write_report
    from mbcacq.workflow.run import Operator, run
    from mbcacq.workflow.simulate import simulate

__all__ = [
    "Budget",
    "CalibratedCell",
    "CalibrationOptions",
    "InterimCheck",
    "CheckSettings",
    "Comparison",
    "DiagnosisResult",
    "Fleet",
    "FleetTask",
    "LoadedPlan",
    "NewPlanOptions",
    "Observations",
    "Operator",
    "RunResult",
    "Sources",
    "Targets",
    "Trajectory",
    "Verification",
    "__version__",
    "calibrate",
    "calibrate_together",
    "check",
    "collect",
    "compare",
    "correct",
    "diagnose",
    "evaluate_fleet",
    "export",
    "extend",
    "investigate",
    "load_observations",
    "load_plan",
    "load_trajectories",
    "new_plan",
    "next_plan",
    "next_poses",
    "run",
    "simulate",
    "verify",
    "verify_elsewhere",
    "write_report",
]

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
