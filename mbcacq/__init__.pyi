"""The names of the library, each once: for type checkers, and for ``__init__.py``, which imports a name when it is first used."""

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
from mbcacq.version import __version__ as __version__
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

__all__: list[str]
