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

Names are imported when they are first used: ``import mbcacq`` alone takes a few milliseconds. ``__init__.pyi`` lists them.
"""

from __future__ import annotations


def _module_of_each_name() -> dict[str, str]:
    """Where the public names are defined: read from the imports that stand in ``__init__.pyi``, ``from module import name as name``."""
    with open(f"{__path__[0]}/__init__.pyi", encoding="utf-8") as file:
        imports = [line.split() for line in file if line.startswith("from ")]
    return {words[3]: words[1] for words in imports}


_MODULE_OF = _module_of_each_name()
__all__ = list(_MODULE_OF)  # pyright: ignore[reportUnsupportedDunderAll]  # type checkers go by __init__.pyi


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    value = getattr(importlib.import_module(_MODULE_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__} - {"annotations"})
