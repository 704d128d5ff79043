"""One exposure: asked for, waited for, and distinguished from data sets that somebody else asked for."""

from __future__ import annotations

import time
from contextlib import suppress

from mbcacq.devices import DeviceTimeout, MbcacqError, Scan
from mbcacq_gocator import commands
from mbcacq_gocator.dataset import DataSet, read_set
from mbcacq_gocator.decode import ArrayMessage, Stamp
from mbcacq_gocator.points import intensity_of, surface_points
from mbcacq_gocator.selection import scan_intensity, scan_surface
from mbcacq_gocator.session import GocatorSession
from mbcacq_gocator.snapshot_scanner import exposure_reported


def expose(session: GocatorSession, exposure_us: float | None) -> Scan:
    """``exposure_us`` None keeps the one that is set. Raises DeviceTimeout, ProtocolError, DeviceFault, ConnectError, Aborted."""
    assert session.configuration is not None
    if exposure_us is not None and not session.configuration.exposes_for(exposure_us):
        session.set_exposure(exposure_us)
    if not session.health.alive:
        with suppress(MbcacqError):
            session.health.open()
    session.check_alignment()
    by_trigger = session.options.mode == "trigger"
    if by_trigger:
        session.start()
    asked = session.time_stamp()
    session.control.request(commands.TRIGGER if by_trigger else commands.SNAPSHOT)
    return _scan(session, *_wait_for_surface(session, asked))


def _wait_for_surface(session: GocatorSession, asked: int) -> tuple[DataSet, Stamp, ArrayMessage]:
    """The first data set with a surface that was exposed after ``asked`` (ticks), its stamp and that surface."""
    assert session.reader is not None
    deadline = time.monotonic() + session.options.timeout_s
    stamp_only, early, other = 0, 0, ""
    while True:
        try:
            data = read_set(session.reader, deadline)
        except DeviceTimeout as error:
            raise _explained(session, error, stamp_only, early, other) from None
        if data.stamp is None:  # nobody can tell when it was exposed, and where the arm was then
            other = ", ".join(filter(None, (data.contents, "without a stamp")))
        elif data.stamp.timestamp < asked:
            early += 1
        elif (surface := scan_surface(data.arrays)) is not None:
            return data, data.stamp, surface
        elif data.contents:
            other = data.contents
        else:
            stamp_only += 1


def _explained(session: GocatorSession, error: DeviceTimeout, stamp_only: int, early: int, other: str) -> DeviceTimeout:
    waited = f"no scan within {session.options.timeout_s:g} s"
    if stamp_only and not other:
        return DeviceTimeout(
            f"{waited}: {stamp_only} data set(s) came with only a stamp; in the job, open Output > Ethernet, choose "
            "the protocol Gocator and tick the surface, then save the job"
        )
    if other:
        return DeviceTimeout(
            f"{waited}: the sensor sent {other} but no surface; set the job's scan mode to Surface and tick the "
            "surface under Output > Ethernet"
        )
    if early:
        return DeviceTimeout(f"{waited}: only {early} older data set(s) came; check that nothing else triggers the sensor")
    return DeviceTimeout(
        f"{waited}: {error}; in the job, tick the surface under Output > Ethernet > Gocator, and check that "
        f"port {session.options.data_port} is not blocked"
    )


def _scan(session: GocatorSession, data: DataSet, stamp: Stamp, message: ArrayMessage) -> Scan:
    assert session.configuration is not None
    grey, wanted_us = scan_intensity(data.arrays, message), session.configuration.exposure_us
    reported_us = message.attributes.get("exposure", 0) / 1000  # ns
    session.exposure = exposure_reported(reported_us, wanted_us)
    session.geometry = tuple(value for name, value in message.attributes.items() if name != "exposure")
    surface = surface_points(message)
    return Scan(
        points=surface.points,
        pixel=surface.pixel,
        shape=surface.shape,
        intensity=None if grey is None else intensity_of(grey, surface),
        time_s=stamp.time_s,
        frame=stamp.frame,
        exposure_us=reported_us or wanted_us or 0.0,
        measurements=data.measurements,
        health=session.health.values(),
    )
