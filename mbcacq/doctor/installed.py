"""Whether the drivers can be imported: all of them, or those a plan names."""

from __future__ import annotations

from collections.abc import Iterator

from mbcacq.devices.installed import Installed, survey
from mbcacq.doctor.line import CheckupLine, Level, from_error
from mbcacq.plan import LoadedPlan


def lines(loaded: LoadedPlan | None) -> Iterator[CheckupLine]:
    """A line for each driver that cannot be used, and one of the others. Without a plan it is a warning: no run fails for it yet."""
    wanted = None if loaded is None else _named(loaded)
    good: list[Installed] = []
    for driver in survey():
        if wanted is not None and (driver.kind, driver.name) not in wanted:
            continue
        if driver.problem:
            level: Level = "warning" if wanted is None else "error"
            yield from_error(f"driver {driver.name}", f"{driver.kind}: {driver.problem}", level)
        else:
            good.append(driver)
    for kind, name in sorted((wanted or set()) - {(d.kind, d.name) for d in survey()}):
        yield CheckupLine(
            "error",
            f"driver {name}",
            f"the plan names a driver '{name}' among the {kind} that is not installed",
            "correct the name (mbcacq drivers lists them), or install its package",
        )
    untried = sorted({d.name for d in good if d.kind != "fakes" and not d.tried})
    if good:
        yield CheckupLine("ok", "drivers", ", ".join(sorted({d.name for d in good})))
    if untried and wanted is not None:
        yield CheckupLine(
            "warning",
            "hardware",
            f"not yet tried on hardware: {', '.join(untried)}",
            "first run in the slow manual mode (T1, TEACH), with --step and a hand on the enabling switch",
        )


def _named(loaded: LoadedPlan) -> set[tuple[str, str]]:
    plan = loaded.plan
    return {
        ("robots", plan.robot.driver),
        ("scanners", plan.scanner.driver),
        ("positioners", plan.positioner.driver),
        *(("sensors", sensor.driver) for sensor in plan.sensors),
    }
