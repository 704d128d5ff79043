"""The protocol of a first contact with real devices: what to look at, in which order, to be ticked by whoever stands at the arm."""

from __future__ import annotations

from pathlib import Path

from mbcacq.devices import load_driver
from mbcacq.files.template import filled
from mbcacq.plan import LoadedPlan


def protocol(loaded: LoadedPlan) -> str:
    """A page of Markdown for this plan. Each driver's own steps are its class attribute ``first_contact``, in order."""
    plan = loaded.plan
    used = [("robots", "robot", plan.robot), ("scanners", "scanner", plan.scanner), ("positioners", "positioner", plan.positioner)]
    used += [("sensors", f"sensor {k}", sensor) for k, sensor in enumerate(plan.sensors, 1)]
    devices = [(role, use.driver, getattr(load_driver(kind, use.driver), "first_contact", ())) for kind, role, use in used]
    page, followed = Path(__file__).with_name("first_contact.md.j2"), plan.robot.follow is not None
    return filled(page, name=plan.name, plan_file=loaded.path.name, devices=devices, followed=followed)
