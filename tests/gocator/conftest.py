"""A recorded conversation of the vendor's client, small frames, and fakes to talk to."""

from __future__ import annotations

import ctypes
import socket
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from gocator_bench import Line, options, read_frame, read_trace
from mbcacq_fakes.protocols.gocator import FakeGocator
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator.build_loop import SOURCE, build
from mbcacq_gocator.conversion import load
from mbcacq_gocator.driver import Gocator


@pytest.fixture(scope="session")
def trace() -> list[Line]:
    return read_trace()


@pytest.fixture(scope="session")
def compiled_loop(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The conversion's loop in C, compiled for these tests."""
    library = build(SOURCE, tmp_path_factory.mktemp("loop"))
    if library is None:
        pytest.skip("no C compiler")
    loop = load(library)
    assert loop is not None
    return loop


@pytest.fixture
def frame() -> ScannerFrame:
    """12 x 20 points of a tilted plane with a hole, and a grey ramp."""
    y, x = np.mgrid[:12, :20].astype(np.float32)
    xyz = np.stack([x * 0.5 - 4, y * 0.5 - 3, 200 + 0.1 * x - 0.05 * y], axis=2)
    xyz[3:6, 7:11] = np.nan
    return ScannerFrame(xyz, (10 * y + x).astype(np.uint8))


@pytest.fixture
def fake(frame: ScannerFrame) -> Iterator[FakeGocator]:
    with FakeGocator(lambda exposure_us: frame) as sensor:
        yield sensor


@pytest.fixture
def driver(fake: FakeGocator) -> Iterator[Callable[..., Gocator]]:
    """Makes drivers for the fake; all are closed at the end."""
    made = []

    def make(model: str = "", sensor: FakeGocator = fake, **more: Any) -> Gocator:
        made.append(Gocator("front", model, options(sensor, **more)))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def talk(fake: FakeGocator) -> Iterator[Callable[[str | bytes], bytes]]:
    """Sends bytes (or hex) over one control connection and returns the one reply frame."""
    with socket.create_connection(("127.0.0.1", fake.ports.control), timeout=5) as sock:

        def exchange(request: str | bytes) -> bytes:
            sock.sendall(bytes.fromhex(request) if isinstance(request, str) else request)
            return read_frame(sock)

        yield exchange
