"""The plan: read, expanded into poses, checked, routed and timed without opening a socket.

A loaded plan is handed on as ``LoadedPlan``, its expansion as a list of ``PlannedPose``.
"""

from mbcacq.plan.expansion import expand
from mbcacq.plan.feasibility import refuse_errors
from mbcacq.plan.loader import load
from mbcacq.plan.planned import LoadedPlan, PlannedPose, Transit
from mbcacq.plan.routing import path

__all__ = ["LoadedPlan", "PlannedPose", "Transit", "expand", "load", "path", "refuse_errors"]
