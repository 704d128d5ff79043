"""Threads of numerical libraries do not help here: several processes run the suite. And no test is about how busy the machine is."""

import gc
import os
import pickle
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from finished_runs import FinishedRun, diagnosed, dry_run
from finished_runs import made_once as make_once
from hypothesis import HealthCheck, settings

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

yaml.SafeLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # of yaml.safe_load: the tests read plans in a tenth of the time

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes start here; without compiled files each compiles the program anew

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # a suite started in the background: what it starts would ignore Ctrl-C, too
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:  # the same after nohup
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_configure(config: pytest.Config) -> None:
    """In a fresh checkout each process of the whole suite would compile all tests. Each begins at another folder and finds what others compiled."""
    worker = getattr(config, "workerinput", None)
    if worker is None:
        return
    gc.disable()  # until all tests are collected: nothing of them is garbage
    if config.args == config.getini("testpaths"):
        entries = sorted(str(path) for path in Path(__file__).parent.iterdir() if path.is_dir() or path.match("test_*.py"))
        first = int(worker["workerid"].removeprefix("gw")) * len(entries) // worker["workercount"]
        config.args = [*entries[first:], *entries[:first]]


def pytest_collection_finish() -> None:
    """Thousands of collected tests stay to the end: the garbage collector need not look through them again and again (4 % of the time)."""
    gc.freeze()
    gc.enable()


HANDLED = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """A command that is typed in this process leaves its handlers behind, which processes started later would inherit."""
    before = {number: signal.getsignal(number) for number in HANDLED}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")

SHARED = Path(__file__).resolve().parents[2] / "shared"  # measured data and facts, beside a checkout; not part of the repository


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measured data and facts. Tests that ask for it are skipped where it is missing."""
    if not SHARED.is_dir():
        pytest.skip(f"the measured data are not in {SHARED}")
    return SHARED


@pytest.fixture(scope="session")
def shared_data(shared: Path) -> Path:
    return shared / "data"


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], None]], Path]:
    """made_once(name, make): the folder that ``make`` has filled, once for all processes of the suite; to be looked at only."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    return lambda name, make: make_once(shared, name, make)


@pytest.fixture(scope="session")
def computed_once(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Callable[[str, Callable[[], object]], Any]:
    """computed_once(name, compute): what ``compute`` returned, once for all processes of the suite; each has a copy of its own."""

    def computed(name: str, compute: Callable[[], object]) -> Any:
        folder = made_once(name, lambda folder: (folder / "value").write_bytes(pickle.dumps(compute())) and None)
        return pickle.loads((folder / "value").read_bytes())

    return computed


@pytest.fixture(scope="session")
def finished_run(made_once: Callable[[str, Callable[[Path], None]], Path]) -> Callable[[str], FinishedRun]:
    """finished_run("quick.yaml"): the whole dry run of a shipped plan; to be looked at only."""
    return lambda plan: FinishedRun(made_once(f"run-of-{plan}", lambda desk: dry_run(desk, plan)))


@pytest.fixture(scope="session")
def concealed_run(finished_run, made_once) -> tuple[FinishedRun, FinishedRun]:
    """The run of plans/concealed.yaml as it was measured, and as it was diagnosed and calibrated with its effects; to be looked at only."""
    measured = finished_run("concealed.yaml")
    return measured, FinishedRun(made_once("diagnosis-of-concealed.yaml", lambda desk: diagnosed(desk, measured)))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that need data from outside the repository: pytest -m "not shared_data" leaves them out. The pages of commands, of
    which one is the longest test of all, begin first, so that no process ends long after the others.
    """
    for item in items:
        if "shared" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.shared_data)
    items.sort(key=lambda item: (item.path.name != "test_commands.py", item.path))
