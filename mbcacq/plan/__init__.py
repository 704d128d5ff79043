"""The plan: read, expanded into poses, checked, routed and timed without opening a socket.

A loaded plan is handed on as ``LoadedPlan``, its expansion as a list of ``PlannedPose``.
"""

from mbcacq.plan.expansion import expand as expand
from mbcacq.plan.feasibility import refuse_errors as refuse_errors
from mbcacq.plan.loader import load as load
from mbcacq.plan.planned import LoadedPlan as LoadedPlan
from mbcacq.plan.planned import PlannedPose as PlannedPose
from mbcacq.plan.planned import Transit as Transit
from mbcacq.plan.routing import path as path
