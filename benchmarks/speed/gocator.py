"""A Gocator's surface to points in mm, beside a loop in C that does the same in one pass."""

from __future__ import annotations

import argparse
import ctypes
import multiprocessing
import platform
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
from bench import HERE
from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_gocator import conversion, points
from mbcacq_gocator.dataset import read_set
from mbcacq_gocator.decode import ArrayMessage, decode
from mbcacq_gocator.layouts import SURFACE_POINTS
from mbcacq_gocator.selection import scan_intensity, scan_surface
from mbcacq_gocator.wire import MessageReader

SHAPE = (1250, 1650)
RECEIVE_BUFFER = 4 * 2**20


def frame(missing: float) -> ScannerFrame:
    """A wavy surface; ``missing`` is the share of pixels lost, in patches as shadows are and in single pixels."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    xyz = np.stack([x * 0.05 - 41, y * 0.05 - 31, 210 + 8 * np.sin(x / 90) * np.cos(y / 70)], axis=2)
    lost = rng.random(SHAPE) < missing / 50
    while lost.mean() < missing:
        row, column = rng.integers(0, SHAPE[0] - 60), rng.integers(0, SHAPE[1] - 80)
        lost[row : row + 60, column : column + 80] = True
    xyz[lost] = np.nan
    return ScannerFrame(xyz, (x + y).astype(np.uint32).astype(np.uint8))


@dataclass(frozen=True)
class Case:
    """One kind of data set. messages: as sent, stamp first, surface second, intensity third if there is one."""

    name: str
    messages: list[bytearray]

    @property
    def surface(self) -> ArrayMessage:
        message = decode(self.messages[1])[0]
        assert isinstance(message, ArrayMessage)
        return message

    @property
    def grey(self) -> ArrayMessage | None:
        message = decode(self.messages[2])[0]
        return message if isinstance(message, ArrayMessage) else None


def cases() -> list[Case]:
    found = []
    for missing in (0.0, 0.3):
        seen = frame(missing)
        for uniform in (False, True):
            for intensity in (False, True):
                header = encode.DataSetHeader(1000.0, 1, 1, 1, uniform=uniform, intensity=intensity)
                name = ("uniform surface" if uniform else "point cloud") + (", intensity" if intensity else "")
                found.append(Case(f"{name}, {missing:.0%} invalid", encode.data_set(seen, header)))
    return found


def compiled(folder: Path) -> ctypes.CDLL:
    library = folder / "gocator_decode.so"
    source = Path(__file__).with_name("gocator_decode.c")
    subprocess.run(["gcc", "-O3", "-march=native", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    found = ctypes.CDLL(str(library))
    found.into_kept.restype = found.into_new.restype = ctypes.c_size_t
    found.received.restype = ctypes.c_long
    return found


class InC:
    """The loop in C on one case."""

    def __init__(self, library: ctypes.CDLL, case: Case) -> None:
        self._library, self._surface, self._grey = library, case.surface, case.grey
        rows, columns = self._surface.array.shape[:2]
        cloud = self._surface.type == SURFACE_POINTS
        attributes = self._surface.attributes
        self._scale = np.array([attributes[f"{axis}_resolution"] / 1e6 for axis in "xyz"], np.float32)
        self._offset = np.array([attributes[f"{axis}_offset"] / 1e3 for axis in "xyz"], np.float32)
        size = (rows * columns, 0) if cloud else (rows, columns)
        self._grid = (*(ctypes.c_size_t(n) for n in size), *map(address, (self._scale, self._offset)))
        self._input = (address(self._surface.array), None if self._grey is None else address(self._grey.array), *self._grid)
        # Written once, so that every page is there.
        self.points = np.ones((rows * columns, 3), np.float32)
        self.pixel, self.intensity = np.ones(rows * columns, np.int32), np.ones(rows * columns, np.uint8)
        self._buffer = np.ones(64 * 2**20, np.uint8)

    def into_new(self) -> int:
        return self._library.into_new(*self._input)

    def into_kept(self) -> int:
        return self._library.into_kept(*self._input, *map(address, (self.points, self.pixel, self.intensity)))

    def with_nan(self) -> None:
        self._library.with_nan(*self._input, address(self.points))

    def received(self, sock: socket.socket) -> int:
        return self._library.received(sock.fileno(), address(self._buffer), ctypes.c_size_t(self._buffer.size), *self._grid)


def address(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def ours(version: ModuleType, case: Case) -> object:
    surface, grey = case.surface, case.grey
    found = version.surface_points(surface)
    return found if grey is None else (found, version.intensity_of(grey, found))


def agree(case: Case, in_c: InC) -> None:
    """Both make the same of it."""
    count, found = in_c.into_kept(), points.surface_points(case.surface)
    np.testing.assert_array_equal(found.pixel, in_c.pixel[:count])
    np.testing.assert_allclose(found.points, in_c.points[:count], rtol=0, atol=6e-5)  # float32 at 0.3 m
    if case.grey is not None:
        np.testing.assert_array_equal(points.intensity_of(case.grey, found), in_c.intensity[:count])


def medians(actions: Sequence[Callable[[], object]], repetitions: int) -> list[float]:
    """Median processor time of this thread in ms for one call of each action; they take turns."""
    times: list[list[float]] = [[] for _ in actions]
    for _ in range(repetitions):
        for own, action in zip(times, actions, strict=True):
            start = time.thread_time()
            action()
            own.append(time.thread_time() - start)
    return [1e3 * statistics.median(own) for own in times]


def with_numpy(case: Case) -> object:
    """As where no compiler was at the installation."""
    compiled_loop, conversion.compiled = conversion.compiled, lambda: None
    try:
        return ours(points, case)
    finally:
        conversion.compiled = compiled_loop


def decoding(library: ctypes.CDLL, repetitions: int) -> Iterator[str]:
    yield "| surface | ours | C, new memory | ours / C | C, kept memory | C, NaN | ours, numpy only |"
    yield "|---|---|---|---|---|---|---|"
    for case in cases():
        in_c = InC(library, case)
        agree(case, in_c)
        actions = [partial(ours, points, case), in_c.into_new, in_c.into_kept, in_c.with_nan, partial(with_numpy, case)]
        own, new, *others = medians(actions, repetitions)
        yield f"| {case.name} | {own:.2f} | {new:.2f} | {own / new:.2f} |" + "".join(f" {t:.2f} |" for t in others)


def replay(case: Case, port: object) -> None:
    """In a process of its own: sends the data set for every byte that comes."""
    everything = b"".join(case.messages)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port.send(server.getsockname()[1])  # type: ignore[attr-defined]
        connection, _ = server.accept()
        with connection:
            while connection.recv(1):
                connection.sendall(everything)


@contextmanager
def replayed(case: Case) -> Iterator[socket.socket]:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=replay, args=(case, there), daemon=True)
    process.start()
    with socket.socket() as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        sock.connect(("127.0.0.1", here.recv()))
        yield sock
    process.join()


def whole_way(library: ctypes.CDLL, repetitions: int) -> Iterator[str]:
    yield "| surface | MB | ours | C | ours / C | received only |"
    yield "|---|---|---|---|---|---|"
    for case in cases():
        size, in_c, scratch = sum(map(len, case.messages)), InC(library, case), bytearray(RECEIVE_BUFFER)
        with replayed(case) as sock:
            reader = MessageReader(sock, "scan")

            def by_driver(sock: socket.socket = sock, reader: MessageReader = reader) -> object:
                sock.send(b"x")
                found = read_set(reader, time.monotonic() + 10)
                message = scan_surface(found.arrays)
                assert message is not None
                grey, surface = scan_intensity(found.arrays, message), points.surface_points(message)
                return surface if grey is None else (surface, points.intensity_of(grey, surface))

            def by_c(sock: socket.socket = sock, in_c: InC = in_c) -> None:
                sock.settimeout(None)
                sock.send(b"x")
                assert in_c.received(sock) > 0

            def bare(sock: socket.socket = sock, size: int = size, scratch: bytearray = scratch) -> None:
                sock.settimeout(None)
                sock.send(b"x")
                while size:
                    size -= sock.recv_into(scratch, min(size, len(scratch)))

            own, in_c_ms, received = medians([by_driver, by_c, bare], repetitions)
        yield f"| {case.name} | {size / 1e6:.1f} | {own:.2f} | {in_c_ms:.2f} | {own / in_c_ms:.2f} | {received:.2f} |"


def gocator(given: argparse.Namespace) -> None:
    """How fast a Gocator's 2-megapixel surface becomes points in mm, against a loop in C that does the same in one pass. Needs gcc.

    The C loop (speed/gocator_decode.c) makes the same arrays (points, pixel, intensity) into new memory, as the driver does, and into
    memory that is kept. The second table is the whole way of a frame: a process replays a recorded data set over the loopback, the
    receiving side decodes it. All repetitions take turns, so that whatever else the computer does concerns all of them.
    """
    if conversion.compiled() is None:
        sys.exit("the driver's loop is not compiled: python -m mbcacq_gocator.build_loop")
    with tempfile.TemporaryDirectory() as folder:
        library = compiled(Path(folder))
        tables = ["\n".join(decoding(library, given.repetitions)), "\n".join(whole_way(library, given.repetitions))]
    text = f"""# Gocator decode

**Question.** How fast does a Gocator message become points?

{SHAPE[0]} x {SHAPE[1]} pixels; median processor time in ms of {given.repetitions} turns, numpy {np.__version__}, {platform.machine()}.
Made by `python benchmarks/speed.py gocator --write`. C: one pass of a loop, `gcc -O3 -march=native`, in the same run
(`speed/gocator_decode.c`), which makes the same arrays; with NaN it makes less, every pixel and no index.
Ours is compiled for any processor of its kind, reads heights once more to count them, and gives back what it did not fill.
'numpy only': without a compiler at the installation.

## A message in memory

{tables[0]}

## From the socket to points

A process replays the data set over the loopback; time of the receiving thread, with what the kernel does for it.

{tables[1]}
"""
    print(text)
    if given.write:
        HERE / "gocator_decode.md".write_text(text)
