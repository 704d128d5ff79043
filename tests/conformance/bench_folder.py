"""The folder driver in front of a scanner's program, whose trigger line passes a proxy."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from mbcacq_fakes.protocols.folder import FakeScannerProgram
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_folder.driver import FolderScanner

from mbcacq.conformance import Channel, Stand, TcpProxy
from mbcacq.spheres.cloud_files import read_points

NO_IDENTITY = {"refuses_the_wrong_device": "files in a folder do not say which scanner made them"}
POINTS = np.arange(60, dtype=np.float32).reshape(4, 5, 3)


@contextmanager
def folder() -> Iterator[Stand]:
    """Every cloud is of another height, so that an old one cannot pass for a new one."""
    with ExitStack() as stack:
        place, exposed = Path(stack.enter_context(tempfile.TemporaryDirectory())), []
        calibration = place / "calibration.txt"
        calibration.write_text("calibrated on 2 March\n")

        def source(exposure_us: float) -> ScannerFrame:
            exposed.append(exposure_us)
            return ScannerFrame(POINTS + np.float32([0, 0, 100 * len(exposed)]))

        program = stack.enter_context(FakeScannerProgram(source, place))
        proxy = stack.enter_context(TcpProxy(Channel("trigger"), ("127.0.0.1", program.port)))
        trigger = {"tcp": f"127.0.0.1:{proxy.port}", "reply": "OK"}
        given = {"folder": place, "pattern": "*.ply", "trigger": trigger, "quiet_s": 0.05, "read_cloud": read_points, "timeout_s": 60.0}
        given["watched"] = [calibration]

        def use(scanner: FolderScanner) -> None:
            before = len(exposed)
            scan = scanner.capture()
            heights = {100 * k for k in range(before + 1, len(exposed) + 1)}
            assert scan.points[0, 2] - POINTS[0, 0, 2] in heights, "the cloud is an old one"

        def begin(scanner: FolderScanner) -> None:
            program.faults.set("no_cloud")
            try:
                scanner.capture()
            finally:
                program.faults.clear()

        yield Stand(
            lambda **more: FolderScanner("scanner", "", {**given, **more}),
            use,
            {"trigger": proxy},
            begin=begin,
            short_limits={"timeout_s": 0.6, "connect_timeout_s": 1.0},
            facts={str(calibration): lambda: calibration.write_text("calibrated on 3 October\n")},
        )
