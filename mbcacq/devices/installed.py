"""Which drivers are installed, from where, whether they can be used, and whether they were ever tried on hardware."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points

from mbcacq import devices
from mbcacq.devices.registry import cure_of

PROTOCOLS = {"robots": devices.Robot, "scanners": devices.Scanner, "positioners": devices.Positioner, "sensors": devices.Sensor}
KINDS = (*PROTOCOLS, "fakes")


@dataclass(frozen=True)
class Installed:
    """One registered driver. package, version: of the distribution that registers it. problem: why it cannot be used, '' if it can.

    tried: on which hardware, '' for none yet; a driver class says so itself by ``verified_on_hardware`` (True, or a text).
    """

    kind: str
    name: str
    target: str
    package: str
    version: str
    problem: str = ""
    tried: str = ""


def survey() -> Iterator[Installed]:
    """All drivers by kind and name. Imports each of them."""
    for kind in KINDS:
        points = sorted(entry_points(group=f"mbcacq.{kind}"), key=lambda point: (point.name, point.value))
        count = Counter(point.name for point in points)
        for point in points:
            problem, tried = _inspect(kind, point)
            if count[point.name] > 1:
                problem = f"{count[point.name]} packages register this name; uninstall all but one"
            package, version = (point.dist.name, point.dist.version) if point.dist is not None else ("", "")
            yield Installed(kind, point.name, point.value, package, version, problem, tried)


def _inspect(kind: str, point: EntryPoint) -> tuple[str, str]:
    try:
        target = point.load()
    except Exception as error:  # an outside package may raise anything when it is imported
        return f"cannot be imported: {type(error).__name__}: {error}; {cure_of(point, error)}", ""
    wanted = PROTOCOLS.get(kind)
    if wanted is not None:
        asked = [name for base in (devices.Device, wanted) for name, method in vars(base).items() if callable(method) and name[0] != "_"]
        missing = [name for name in (*asked, "__enter__", "__exit__") if not callable(getattr(target, name, None))]
        if missing:
            return f"lacks {', '.join(missing)}", ""
    tried = getattr(target, "verified_on_hardware", False)
    return "", ("yes" if tried is True else str(tried)) if tried else ""
