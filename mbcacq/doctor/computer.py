"""Python, libraries, disk, shared memory, real-time rights, pictures without a screen."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from mbcacq.doctor.line import CheckupLine
from mbcacq.recording.viewer.vulkan import PACKAGE, has_vulkan, vulkan_drivers

LIBRARIES = {  # distribution: module; None: only its presence is asked for
    "numpy": "numpy",
    "scipy": "scipy",
    "pydantic": "pydantic",
    "rerun-sdk": "rerun",
    "mujoco-core": "mujoco",
    "ruckig": "ruckig",
    "pymodbus": "pymodbus",
    "pyserial": "serial",
}
LEAST_DISK, GOOD_DISK = 256 << 20, 4 << 30
LEAST_SHARED = 64 << 20


def lines() -> Iterator[CheckupLine]:
    yield _python()
    yield from _libraries()
    yield from _disk()
    yield _priority()
    yield _vulkan()


def _python() -> CheckupLine:
    here = f"Python {sys.version.split()[0]} in {sys.prefix}"
    if sys.prefix == sys.base_prefix:
        return CheckupLine("warning", "python", f"{here}, in no environment of its own", "python3 -m venv .venv, and install mbcacq there")
    return CheckupLine("ok", "python", here)


def _libraries() -> Iterator[CheckupLine]:
    good = []
    for name, module in LIBRARIES.items():
        problem = _problem(name, module)
        if problem:
            yield CheckupLine("error", f"library {name}", problem, f"{sys.executable} -m pip install '{name}'")
        else:
            good.append(f"{name} {importlib.metadata.version(name)}")
    yield CheckupLine("ok", "libraries", ", ".join(good))


def _problem(name: str, module: str | None) -> str:
    try:
        importlib.metadata.version(name)
        if module is not None:
            importlib.import_module(module)
    except importlib.metadata.PackageNotFoundError:
        return f"{name} is not installed"
    except Exception as error:  # a binary library may raise anything when it is loaded
        return f"{name} cannot be imported: {error}"
    return ""


def _disk() -> Iterator[CheckupLine]:
    here = Path("runs") if Path("runs").is_dir() else Path(".")
    free = shutil.disk_usage(here).free
    text = f"{free / 2**30:.1f} GiB free for recordings in {here.resolve()}"
    if free < LEAST_DISK:
        yield CheckupLine("error", "disk", text, "free some space, or record elsewhere with --out")
    elif free < GOOD_DISK:
        yield CheckupLine(
            "warning", "disk", text, "a long plan with dense scans may need more; free some space, or record elsewhere with --out"
        )
    else:
        yield CheckupLine("ok", "disk", text)
    shared = Path("/dev/shm")
    if shared.is_dir() and shutil.disk_usage(shared).free < LEAST_SHARED:
        free = shutil.disk_usage(shared).free >> 20
        yield CheckupLine(
            "error", "shared memory", f"{free} MiB free in /dev/shm", "delete what dead programs left there, or mount it larger"
        )


def _priority() -> CheckupLine:
    """A robot's cycle that waits behind other programs, or for memory that was paged out, answers late."""
    cores = os.cpu_count() or 1
    if sys.platform != "linux":
        return CheckupLine("ok", "cycle", f"{cores} processor cores")
    import resource

    root = os.geteuid() == 0
    missing = {
        "take real-time priority": ("rtprio 80", root or resource.getrlimit(resource.RLIMIT_RTPRIO)[0] > 0),
        "lock its memory": ("memlock unlimited", root or resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY),
    }
    refused = {what: limit for what, (limit, permitted) in missing.items() if not permitted}
    if not refused:
        return CheckupLine("ok", "cycle", f"{cores} processor cores; the robot's cycle may {' and '.join(missing)}")
    lines = " and ".join(f"'@realtime - {limit}'" for limit in refused.values())
    return CheckupLine(
        "warning",
        "cycle",
        f"{cores} processor cores, but of this user the robot's cycle may not {' nor '.join(refused)}",
        f"put {lines} into /etc/security/limits.d/mbcacq.conf, join the group realtime, log in again",
    )


def _vulkan() -> CheckupLine:
    if has_vulkan():
        return CheckupLine("ok", "pictures", f"Vulkan drivers: {', '.join(vulkan_drivers()) or 'the system has its own'}")
    return CheckupLine("warning", "pictures", "no Vulkan driver: mbcacq view --screenshot will not work without a screen", PACKAGE)
